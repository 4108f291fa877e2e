"""Laws of one joint that read nothing unseen, so that studies keep their runs."""

from __future__ import annotations

import numpy as np

from controller.control_law import Diagnostics


class Feedback:
    """A PD law whose gains may have any sign."""

    def __init__(self, model, stiffness=0.0, damping=0.0):
        self.diagnostics = Diagnostics(model.joints)
        self._stiffness, self._damping = stiffness, damping

    def reset(self):
        pass

    def torque(self, tracking):
        return -self._stiffness * tracking.error - self._damping * tracking.error_rate


class Policy:
    """A policy that sends positions along `WAVE`, with a row for each millisecond or `spacing_s`.

    Without their velocities, the drives' own loop follows them two of its time constants behind.
    """

    def __init__(self, model, rows=1, spacing_s=1e-3, knows_velocity=False):
        self.diagnostics, self._knows_velocity = Diagnostics(model.joints), knows_velocity
        self._later_s = spacing_s * np.arange(rows)

    def reset(self):
        pass

    def torque(self, tracking):
        return np.zeros_like(tracking.error)

    def target(self, tracking):
        times_s = tracking.time_s + self._later_s
        velocities = 0.5 * np.sin(times_s) if self._knows_velocity else np.zeros_like(times_s)
        return np.stack([-0.5 * np.cos(times_s), velocities], axis=1)[:, :, None]
