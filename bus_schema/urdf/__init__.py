"""Reading, checks and repairs of a URDF before a simulator loads it."""
