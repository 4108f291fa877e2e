"""Emulated robots that answer vendors' own clients, a folder for each maker."""
