"""Laws for robots that take positions or velocities: loops around a robot's own controller.

Besides `torque`, which is zero, such a law has a method ``target``: positions, rad, and
velocities, rad/s, as rows, shape (2, joints). `OuterLaw.follow` gives it the reference, which it
may read ahead.
"""
