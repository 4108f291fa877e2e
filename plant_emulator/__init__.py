"""The plant emulator: an arm in pybullet with the hardware around it."""
