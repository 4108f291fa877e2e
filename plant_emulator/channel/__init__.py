"""The emulated link: delays, losses and order of messages."""
