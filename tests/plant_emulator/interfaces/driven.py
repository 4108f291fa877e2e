"""Drive a robot's own controller through cycles, as the arm does."""

import numpy as np

PERIOD_S = 1e-3


def started(settings, period_s=PERIOD_S, joints=1):
    """A controller at rest at zero."""
    robot = settings.build(period_s)
    robot.start(np.zeros(joints))
    return robot


def rows(position, velocity=0.0):
    """A target for one joint."""
    return np.array([[float(position)], [float(velocity)]])


def driven(robot, targets, follows=True):
    """The motions of all cycles, as rows of position, velocity, acceleration of the first joint.

    The joints follow exactly.
    """
    measured, found = np.zeros((2, 1)), []
    for target in targets:
        motion = robot.step(target, measured)
        found.append([each[0] for each in motion])
        if follows:
            measured = np.stack(motion[:2])
    return np.array(found)
