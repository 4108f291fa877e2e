"""What a process of a run stands on: clocks, scheduling, modes, compiled code."""
