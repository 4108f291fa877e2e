"""A run's side of a live view: the recorder's snapshots, and their way to the viewer."""
