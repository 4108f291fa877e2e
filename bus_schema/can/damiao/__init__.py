"""Damiao motors, such as those of OpenArm: their frames, registers and master."""
