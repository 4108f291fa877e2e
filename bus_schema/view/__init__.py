"""Messages for 3-D viewers: the arm, and the poses of its links."""
