"""Identify a law as a linear one, by asking it what follows a small motion.

The arm is at rest at its start, the reference too, and the funnel is that at the end of the run.
A motion moves all that a law sees of it: positions and velocities, errors and their rates.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.arrays import Matrix
from controller.control_law import ControlLaw, Tracking
from deploy.scenario.setup import Setup
from deploy.study.theory.linear_law import LinearLaw, filtered, fitted

_SWITCHES = "it has no slope at zero error: it switches, or its gain depends on the error"
_VARIES = "its answers to several errors do not add up, or they depend on when it is asked"
_IDLE = "its torque does not depend on errors"
_WORKING_RANGE = 0.01
"""Of the funnel's final size, in which a law has to be linear."""
_AGREE = 0.01
_LISTENED_S, _LISTENED_TICKS = 1.0, (256, 2048)
_MIXED_TICKS = 64


def linear_law(law: ControlLaw, setup: Setup) -> LinearLaw | str:
    """Return a law as a linear one, N m per rad and rad/s; or why it is none."""
    probe = _Probe(law, setup)
    impulses = probe.impulses()
    heard = np.array([probe.answer(motion) for motion in impulses])
    if not heard.any():
        return _IDLE
    for share in (-1.0, 0.1):
        again = [probe.answer(share * motion) / share for motion in impulses]
        if not _agree(np.array(again), heard):
            return _SWITCHES
    found = fitted(np.concatenate(heard, axis=1))
    if found is None:
        heard_s = probe.period_s * heard.shape[1]
        return f"its answer to an error has not ended after {heard_s:g} s: it filters or learns"
    model = LinearLaw(probe.taps(*found), found[1])
    mixed = probe.mixed(found[0] + _MIXED_TICKS)
    answer, expected = (
        np.array([find(motion) for motion in mixed]) for find in (probe.answer, model.torques)
    )
    return model if _agree(answer, expected) else _VARIES


class _Probe:
    """Asks a law; motions have the shape (ticks, 2 joints): positions, then velocities."""

    def __init__(self, law: ControlLaw, setup: Setup) -> None:
        self._law, self._setup = law, setup
        self.period_s = 1e-9 * setup.grid.period_ns
        self._random = np.random.default_rng(0)
        self._sizes = _WORKING_RANGE * np.tile(setup.funnel.final_rad, 2)  # a rate: of 1/s
        fewest, most = _LISTENED_TICKS
        self._ticks = min(max(round(_LISTENED_S / self.period_s), fewest), most)
        self._rest = self._torques(np.zeros((self._ticks, self._sizes.size)))

    def answer(self, motion: Matrix) -> Matrix:
        """Return what a motion changes of the torques, shape (ticks, joints)."""
        return self._torques(motion) - self._rest[: len(motion)]

    def impulses(self) -> Any:
        """Return impulses of all positions, and of all velocities, by unequal shares."""
        return self._apart(self._one_tick(self._shares(1)[0], self._ticks))

    def mixed(self, ticks: int) -> Any:
        """Return motions of all positions, and of all velocities, at random."""
        return self._apart(self._shares(ticks) * self._sizes)

    def taps(self, ticks: int, recursion: Any) -> Any:
        """Return the taps of a law with this recursion, by an impulse of each input."""
        answers = [
            self.answer(self._one_tick(share, ticks)) for share in np.eye(self._sizes.size)
        ]
        return filtered(np.stack(answers, 2) / self._sizes, recursion)

    def _one_tick(self, shares: Any, ticks: int) -> Matrix:
        motion = np.zeros((ticks, self._sizes.size))
        motion[0] = shares * self._sizes
        return motion

    def _shares(self, ticks: int) -> Matrix:
        size = ticks, self._sizes.size
        return self._random.uniform(0.5, 1.0, size) * self._random.choice([-1.0, 1.0], size)

    def _apart(self, motion: Matrix) -> Any:
        is_rate = np.arange(self._sizes.size) >= self._sizes.size // 2
        return np.array([motion * ~is_rate, motion * is_rate])

    def _torques(self, motion: Matrix) -> Matrix:
        """Return the torques during a motion that begins after a tick at rest."""
        self._law.reset()
        setup, h = self._setup, self.period_s
        tracking, start = Tracking(setup.robot.joints), setup.start_position_rad
        answers = []
        for tick, moved in enumerate([np.zeros(self._sizes.size), *motion]):
            time_s = setup.scenario.duration_s + h * tick
            tracking.update(time_s, h if tick else 0.0, setup.reference, setup.funnel)
            tracking.error[:], tracking.error_rate[:] = moved.reshape(2, -1)
            tracking.reference_position[:] = start
            tracking.reference_velocity[:] = tracking.reference_acceleration[:] = 0.0
            tracking.motion[:] = start + tracking.error, tracking.error_rate
            answers.append(np.array(self._law.torque(tracking), dtype=np.float64))
        return np.array(answers[1:])


def _agree(found: Any, expected: Any) -> bool:
    """Whether answers agree, by motion and joint, up to 1 % of the joint's largest one."""
    largest = abs(expected).max(axis=1)
    return bool((abs(found - expected).max(axis=1) <= _AGREE * largest + 1e-6 * largest.max()).all())
