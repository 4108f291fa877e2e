"""Arms in MJCF files: the files, their joints and actuators, and their bodies as a URDF."""
