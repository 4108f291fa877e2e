"""Sweeps: every point of a grid with every seed."""
