"""Carriers of bytes beside Zenoh, each a `Transport` in a module of its own, named `Near`."""
