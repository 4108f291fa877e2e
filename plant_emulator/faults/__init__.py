"""Scheduled faults: start, duration and effect of each kind."""
