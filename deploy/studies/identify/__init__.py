"""Identification of an arm from its own logs: command and page."""
