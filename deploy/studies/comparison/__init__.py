"""Comparisons: a scenario under several laws."""
