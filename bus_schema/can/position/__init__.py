"""Cycles in which drives get targets beside torques, and close loops of their own around them."""
