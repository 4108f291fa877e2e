"""Runtime of a process: clocks, scheduling, modes, compiled code."""
