"""Terminal output of commands: results and progress."""
