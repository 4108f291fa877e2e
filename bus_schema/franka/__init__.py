"""libfranka's research interface, version 10: commands over TCP, states and targets over UDP."""
