"""The plant emulator: an arm in a physics engine, with the hardware around it."""
