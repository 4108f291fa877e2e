"""Tunings: a search for the gains of laws."""
