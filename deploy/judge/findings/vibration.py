"""Vibration: torque that swings between its limits, as of a limit cycle of an unstable loop.

A switching law chatters by its nature, with a torque below the limits. A loop that has become
unstable swings as far as its motors let it, inside its bounds or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Matrix, Vector
from deploy.judge.findings.chattering import power_spectrum

_PART = 0.5
"""Share of a run, at its end, that is looked at."""
_FAST_HZ = 5.0
"""An arm's motions are slower."""
_LEAST_SATURATED = 0.01
"""Share of ticks; 0 for switching laws, from 0.07 up for limit cycles."""
_LEAST_RMS = 0.3
"""RMS of the fast torque over its limit: a sine between the limits has 0.71."""
_NEAR_LIMIT = 0.5
"""Share of its limit from which a joint's torque may be what saturates: the actuator's lag makes it
smaller than what is asked for."""


@dataclass(frozen=True)
class Vibration:
    """Torque that swings between its limits.

    Attributes:
        frequency_hz: where the torque's spectrum above 5 Hz is largest.
        saturated_fraction: share of ticks at which the joint's actuator saturates.
        torque_rms_share: RMS of the torque above 5 Hz over its limit.
    """

    frequency_hz: float
    saturated_fraction: float
    torque_rms_share: float


def at_limits(torques_nm: Matrix, saturated: Vector, limits_nm: Vector) -> Matrix:
    """Return 1 or -1 where a joint's torque is at a limit, the sign of the torque, and 0 elsewhere.

    Args:
        torques_nm: of the actuators at every tick, shape (ticks, joints).
        saturated: whether any actuator saturates, shape (ticks,).
        limits_nm: largest torques, shape (joints,).
    """
    is_near = np.abs(torques_nm) >= _NEAR_LIMIT * limits_nm
    return np.where(is_near & (saturated[:, None] != 0), np.sign(torques_nm), 0.0)


def vibrations(
    torques_nm: Matrix, saturated: Vector, limits_nm: Vector, rate_hz: float
) -> list[Vibration | None]:
    """Return how each joint vibrates over the last half of a run; None if it does not.

    Args:
        torques_nm: as for `at_limits`, evenly spaced in time; likewise the next two.
        saturated: likewise.
        limits_nm: likewise.
        rate_hz: ticks per second.
    """
    last = slice(round((1.0 - _PART) * len(torques_nm)), None)
    if len(torques_nm[last]) < rate_hz / _FAST_HZ:
        return [None] * torques_nm.shape[1]
    shares = np.abs(at_limits(torques_nm, saturated, limits_nm)[last]).mean(axis=0)
    if not (shares >= _LEAST_SATURATED).any():
        return [None] * len(shares)
    frequencies, power = power_spectrum(torques_nm[last], rate_hz)
    power[frequencies <= _FAST_HZ] = 0.0
    rms_shares = np.sqrt(power.sum(axis=0)) / limits_nm
    return [
        Vibration(hertz, share, rms)
        if share >= _LEAST_SATURATED and rms >= _LEAST_RMS
        else None
        for hertz, share, rms in zip(
            frequencies[power.argmax(axis=0)].tolist(), shares.tolist(), rms_shares.tolist(),
            strict=True,
        )
    ]  # fmt: skip
