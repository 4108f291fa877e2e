"""The link over CAN: frames, masters of drives, and a bus's time."""
