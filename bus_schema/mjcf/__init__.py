"""Arms described in MuJoCo's format, written as URDF."""
