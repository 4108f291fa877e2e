"""Emulated motor drives on a CAN bus."""
