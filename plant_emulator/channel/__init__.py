"""What the emulated link does to messages."""
