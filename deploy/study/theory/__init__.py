"""Theoretical delay margins of a linear loop, from a scenario alone, without a run."""
