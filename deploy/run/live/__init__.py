"""What a run does for a live view of it: what its recorder passes on, and the viewer's process."""
