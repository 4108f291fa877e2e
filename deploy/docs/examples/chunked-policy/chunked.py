"""A policy that answers with 16 actions, as a trained one does that has learned one trajectory.

From the position that it observes, its actions return to the trajectory within a second.
"""

import numpy as np

from funnel_hil import Diagnostics

ACTIONS, PERIOD_S, RETURN_S = 16, 0.04, 0.3
CENTRE_RAD = np.array([0.0, -1.2, 1.4, -1.8, -1.57, 0.0])
AMPLITUDE_RAD = np.array([0.5, 0.3, 0.4, 0.4, 0.5, 0.6])
FREQUENCY_RAD_S = np.array([0.8, 0.6, 0.7, 0.9, 1.0, 1.1])
LEAD_S = 0.03
"""Lead of its demonstrations, s, which makes up for the robot's own lag."""


class Policy:
    def __init__(self, model):
        self.diagnostics = Diagnostics(model.joints)

    def reset(self):
        pass

    def torque(self, tracking):
        return np.zeros_like(tracking.error)  # the robot's own controller makes the torque

    def target(self, tracking):
        ahead_s = PERIOD_S * np.arange(ACTIONS)[:, np.newaxis]
        angle = FREQUENCY_RAD_S * (tracking.time_s + LEAD_S + ahead_s)
        left = np.exp(-ahead_s / RETURN_S)
        position = CENTRE_RAD + AMPLITUDE_RAD * np.cos(angle) + tracking.error * left
        velocity = -AMPLITUDE_RAD * FREQUENCY_RAD_S * np.sin(angle)
        return np.stack([position, velocity - tracking.error * left / RETURN_S], axis=1)
