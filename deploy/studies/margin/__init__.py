"""Margins: the largest delay, or other quantity, at which each law keeps its bounds."""
