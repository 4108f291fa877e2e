"""Figures of the arm in space: how it moves, how it stands, where its tip goes."""
