"""Scheduled faults: what breaks, when, for how long, and what it does."""
