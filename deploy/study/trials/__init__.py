"""Trials of a value: which runs decide whether it is tolerated, and when they are enough."""
