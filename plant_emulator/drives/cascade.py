"""The loops of servo drives in position mode: position, velocity and torque.

    velocity wanted = v* + K_x (q* − q), at most the speed limit
    torque wanted   = τ* + K_v (velocity wanted − q̇) + integral, at most the torque limit

That is CiA 402's cyclic synchronous position mode with its offsets, and ODrive's controller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

_DECAY = 0.99
"""Of the integral while the torque is limited, each time the loop is closed (ODrive's)."""


class CascadeGains(NamedTuple):
    """Gains of a drive's loops, at the joint.

    Attributes:
        position_1_s: K_x, speed per rad off the target.
        velocity_nm_s: K_v, torque per rad/s off the speed wanted.
        integral_nm_rad: what the integral grows by, per rad/s off the speed wanted, each second.
    """

    position_1_s: float
    velocity_nm_s: float
    integral_nm_rad: float = 0.0


UNTUNED = CascadeGains(20.0, 20.0)
"""Gains of a drive that is not tuned to its joint."""


@dataclass
class Integral:
    """Integral of a velocity loop, which is kept when targets change."""

    torque_nm: float = 0.0


class CascadeLoop(NamedTuple):
    """A loop around a target, see `drive.Loop`.

    Attributes:
        target_rad: q*, where the joint is to be.
        velocity_rad_s: v*, its feed-forward.
        feedforward_nm: τ*.
        gains: of the loop; with K_x = 0 it is velocity that is controlled.
        step_rad: resolution of the drive's encoder.
        most_rad_s: the highest speed wanted.
        most_nm: the most torque there is.
        integral: of the velocity loop.
    """

    target_rad: float
    velocity_rad_s: float
    feedforward_nm: float
    gains: CascadeGains
    step_rad: float
    most_rad_s: float
    most_nm: float
    integral: Integral

    @property
    def is_closed(self) -> bool:
        """Whether the torque depends on the joint's motion."""
        return True

    def torque_nm(self, position_rad: float, velocity_rad_s: float, step_s: float = 0.0) -> float:
        """Torque of the loop for the next `step_s`."""
        gains = self.gains
        seen_rad = round(position_rad / self.step_rad) * self.step_rad
        wanted_rad_s = self.velocity_rad_s + gains.position_1_s * (self.target_rad - seen_rad)
        lacking_rad_s = _clamped(wanted_rad_s, self.most_rad_s) - velocity_rad_s
        gathered_nm = self.integral.torque_nm
        wanted_nm = self.feedforward_nm + gains.velocity_nm_s * lacking_rad_s + gathered_nm
        given_nm = _clamped(wanted_nm, self.most_nm)
        if given_nm != wanted_nm:
            gathered_nm *= _DECAY
        else:
            gathered_nm += gains.integral_nm_rad * lacking_rad_s * step_s
        if step_s > 0.0:
            self.integral.torque_nm = gathered_nm
        return given_nm


def _clamped(value: float, most: float) -> float:
    return min(max(value, -most), most)
