"""Margins over uncertain plants: the share that keeps its bounds at each value."""
