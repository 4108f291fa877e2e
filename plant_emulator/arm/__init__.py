"""The arm: physics, joints' hardware, friction and disturbance."""
