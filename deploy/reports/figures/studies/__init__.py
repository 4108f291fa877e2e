"""Figures of studies and comparisons: many runs in one picture."""
