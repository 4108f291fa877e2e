"""Tuning: the gains of laws, found by one search."""
