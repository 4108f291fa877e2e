"""Kinds of links between controller and plant: one file each, and a table of them."""
