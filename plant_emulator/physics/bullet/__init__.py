"""Bullet as a physics engine: its C functions, an arm on them, and pictures."""
