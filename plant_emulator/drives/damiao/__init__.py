"""Damiao motors: modes, registers, errors."""
