"""Identify a law as a linear one, by asking it what follows a small motion.

The arm is at rest at its start, the reference too, and the funnel is that at the end of the run.
A motion moves all that a law sees of it: positions and velocities, errors and their rates.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.control_law import ControlLaw, Tracking
from deploy.scenario.setup import Setup
from deploy.study.theory.linear_law import ENDED, LinearLaw, filtered, fitted

_SWITCHES = "the law switches or its gain depends on the error, so it has no slope at zero error"
_VARIES = "its answers to several errors do not add up, or they depend on when it is asked"
_IDLE = "its torque does not depend on errors"
_SMALL, _LARGER = 1e-3, 10.0
"""Size of a motion, in that of the funnel at the end; and by how much a law is linear beyond it."""
_AGREE, _NOISE = 0.01, 1e-6
_FEW_TICKS = 64
_LISTENED_S, _LISTENED_TICKS = 1.0, (256, 2048)


def linear_law(law: ControlLaw, setup: Setup, row: int | None = None) -> LinearLaw | str:
    """Return a law as a linear one, N m per rad and rad/s; or why it is none.

    Args:
        law: the law.
        setup: the scenario.
        row: of its targets, instead of torques.
    """
    probe = _Probe(law, setup, row)
    impulses = probe.impulses(_FEW_TICKS)
    (odd, even), (larger_odd, larger_even) = (
        [part / size for part in probe.parts(size * impulses)] for size in (1.0, _LARGER)
    )
    if not (odd.any() or even.any()):
        return _IDLE
    # Beside its slope, a smooth law may answer with squares: less, the smaller the motion.
    allowed = np.maximum(_AGREE * _largest(odd), 0.5 * _largest(larger_even))
    is_smooth = (_largest(even) <= allowed + _NOISE * _largest(odd).max()).all()
    if not (is_smooth and _agree(larger_odd, odd)):
        return _SWITCHES
    ticks = min(max(round(_LISTENED_S / probe.period_s), _LISTENED_TICKS[0]), _LISTENED_TICKS[1])
    end = fitted(np.concatenate(probe.answers(probe.impulses(ticks)), axis=1))
    if end is None:
        heard_s = f"{probe.period_s * ticks:g} s"
        return f"its answer to an error has not ended after {heard_s}: it filters or learns"
    found = LinearLaw(probe.taps(*end), end[1])
    mixed = probe.mixed(end[0] + _FEW_TICKS)
    expected = np.array([found.torques(motion) for motion in mixed])
    return found if _agree(probe.answers(mixed), expected) else _VARIES


class _Probe:
    """Asks a law; motions have the shape (ticks, 2 joints): positions, then velocities."""

    def __init__(self, law: Any, setup: Setup, row: int | None) -> None:
        self._law, self._setup, self._row = law, setup, row
        self.period_s = 1e-9 * setup.grid.period_ns
        self._sizes = _SMALL * np.tile(setup.funnel.final_rad, 2)  # a rate: of 1/s

    def answers(self, motions: Any) -> Any:
        """Return the linear part of the answers to motions, shape (motions, ticks, joints)."""
        return np.array([0.5 * (self._torques(each) - self._torques(-each)) for each in motions])

    def parts(self, motions: Any) -> tuple[Any, Any]:
        """Return the linear part of the answers to motions, and what remains of it."""
        at_rest = self._torques(0.0 * motions[0])
        odd = self.answers(motions)
        return odd, np.array([self._torques(each) for each in motions]) - at_rest - odd

    def impulses(self, ticks: int) -> Any:
        """Return an impulse of all positions and one of all velocities, by unequal shares."""
        return self._apart(self._impulse(self._shares(1)[0], ticks))

    def mixed(self, ticks: int) -> Any:
        """Return a motion of all positions and one of all velocities, which differ in each tick."""
        return self._apart(self._shares(ticks) * self._sizes)

    def taps(self, ticks: int, recursion: Vector) -> Any:
        """Return the taps of a law with this recursion, by an impulse of each input."""
        impulses = np.array([self._impulse(share, ticks) for share in np.eye(self._sizes.size)])
        responses = np.moveaxis(self.answers(impulses), 0, 2) / self._sizes
        taps = filtered(responses, recursion)
        counts = (abs(taps) > ENDED * abs(taps).max(axis=0)).any(axis=(1, 2))
        return taps[: np.flatnonzero(counts)[-1] + 1]

    def _impulse(self, shares: Vector, ticks: int) -> Matrix:
        motion = np.zeros((ticks, self._sizes.size))
        motion[0] = shares * self._sizes
        return motion

    def _shares(self, ticks: int) -> Any:
        """Return numbers of modulus ½ to 1, the same in every call."""
        random, size = np.random.default_rng(0), (ticks, self._sizes.size)
        return random.uniform(0.5, 1.0, size) * random.choice([-1.0, 1.0], size)

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
            answer = self._law.torque(tracking)
            if self._row is not None:
                answer = self._law.target(tracking)[self._row]
            answers.append(np.array(answer, dtype=np.float64))
        return np.array(answers[1:])


def _largest(answers: Any) -> Any:
    """Return the largest torques, by motion and joint."""
    return abs(answers).max(axis=1)


def _agree(found: Any, expected: Any) -> bool:
    """Whether answers agree, by motion and joint, up to 1 % of the joint's largest one."""
    largest = _largest(expected)
    return bool((_largest(found - expected) <= _AGREE * largest + _NOISE * largest.max()).all())
