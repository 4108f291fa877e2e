"""Checks of a scenario, warnings about it, and explanations of wrong values."""
