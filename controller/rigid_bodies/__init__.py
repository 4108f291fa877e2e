"""Rigid-body dynamics of an arm for compiled code."""
