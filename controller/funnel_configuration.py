"""Section ``funnel`` of a scenario, and the funnel that it builds."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from bus_schema.arrays import Vector
from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    PerJointPositive,
    Positive,
    StrictModel,
    expand,
)
from controller.funnel import Funnel


class FunnelConfiguration(StrictModel):
    """The prescribed performance: how wide the funnel starts, how fast and how far it closes.

    The funnel opens to ``convergence_scale × |e(0)| + convergence_margin_rad`` on the side of the
    initial error e(0) and to ``overshoot_scale × |e(0)| + overshoot_margin_rad`` on the other, but
    never beyond ``widest_rad``; both sides close to ``final_rad`` at ``rate_per_s``.
    """

    convergence_scale: NonNegative = 1.2
    convergence_margin_rad: NonNegative = 0.05
    overshoot_scale: NonNegative = 0.4
    overshoot_margin_rad: NonNegative = 0.03
    widest_rad: Positive = 1.5
    final_rad: PerJointPositive = Field(default_factory=lambda: np.array([0.01]))
    rate_per_s: Positive = 4.0

    def build(self, initial_error_rad: Vector) -> Funnel:
        """The funnel for an initial error, shape (joints,).

        Raises:
            ConfigurationError: the initial error is outside, or a side would have to widen.
        """
        joints = initial_error_rad.size
        final = expand(self.final_rad, joints, "funnel.final_rad")
        size = np.abs(initial_error_rad)
        near = self.convergence_scale * size + self.convergence_margin_rad
        far = self.overshoot_scale * size + self.overshoot_margin_rad
        near, far = np.minimum(near, self.widest_rad), np.minimum(far, self.widest_rad)
        if np.any(size >= near):
            joint = int(np.argmax(size - near))
            raise ConfigurationError(
                "robot.initial_offset_rad",
                initial_error_rad.tolist(),
                f"the initial error of joint {joint + 1} must lie inside the funnel, which opens"
                f" to {near[joint]:.4g} rad there",
            )
        if np.any(far < final) or np.any(near < final):
            raise ConfigurationError(
                "funnel.final_rad", final.tolist(), "must not exceed the bounds at time zero"
            )
        above = initial_error_rad >= 0.0
        return Funnel(
            np.where(above, near, far), np.where(above, far, near), final, self.rate_per_s
        )
