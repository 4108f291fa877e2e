"""What can carry bytes between two processes, each in a module with `Near` and `answer`."""
