"""An xArm controller in servo mode, as far as ``xarm-python-sdk`` uses it."""
