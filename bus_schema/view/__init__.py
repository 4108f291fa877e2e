"""What 3-D viewers need of a run: the arm, and where its links are."""
