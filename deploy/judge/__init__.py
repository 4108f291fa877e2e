"""Evaluation of recordings: figures, bounds and their conditions."""
