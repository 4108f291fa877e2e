"""Measures networks and systems of others, and writes what the emulated link replays."""
