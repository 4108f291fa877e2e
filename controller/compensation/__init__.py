"""Delay compensation: the state in which a torque will act."""
