"""A jerk-limited curve from the motion in force to a new chunk; this file alone uses ruckig."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Positive
from bus_schema.errors import needs_extra
from controller.chunks.answer import Answer
from controller.chunks.merge import ChunkMerge, ChunkTiming, MergeSettings

_FASTEST_RAD_S = 1e3
"""In place of a missing limit."""


class Spline(ChunkMerge):
    """A jerk-limited curve to the first row of the new chunk that the joints can reach in time.

    Args:
        timing: of the chunks; the curve has a row for each tick.
        acceleration_rad_s2: largest one.
        jerk_rad_s3: largest one.
    """

    def __init__(self, timing: ChunkTiming, acceleration_rad_s2: float, jerk_rad_s3: float) -> None:
        import ruckig

        joints = len(timing.velocities_rad_s)
        self._ruckig, self._tick_s = ruckig, timing.tick_s
        self._generator = ruckig.Ruckig(joints)
        self._motion: Any = ruckig.InputParameter(joints)
        self._motion.max_velocity = np.minimum(timing.velocities_rad_s, _FASTEST_RAD_S).tolist()
        self._motion.max_acceleration = [acceleration_rad_s2] * joints
        self._motion.max_jerk = [jerk_rad_s3] * joints
        self._curve: Any = None
        self._begin_s = self._end_s = 0.0

    def merged(self, old: Answer, new: Answer, now_s: float) -> Answer:
        fine = self._at_ticks(new)
        here = fine.row_at(now_s)
        start = old.target_at(now_s)
        self._motion.current_position, self._motion.current_velocity = start.tolist()
        self._motion.current_acceleration = self._acceleration(old, now_s).tolist()
        curve, rows = self._to_reachable(fine.targets[here:], new, now_s)
        if curve is None:
            return fine
        targets = fine.targets.copy()
        for row in range(rows):
            position, velocity, _ = curve.at_time(row * self._tick_s)
            targets[here + row] = position, velocity
        self._curve, self._begin_s, self._end_s = curve, now_s, now_s + rows * self._tick_s
        return replace(fine, targets=targets)

    def reset(self) -> None:
        self._curve = None

    def _acceleration(self, old: Answer, now_s: float) -> Vector:
        """Return the acceleration in force: that of the curve, or of the old chunk behind it."""
        if self._curve is None or now_s >= self._end_s:
            return self._within_limits(old.acceleration_at(now_s))
        return np.array(self._curve.at_time(now_s - self._begin_s)[2])

    def _within_limits(self, acceleration: Vector) -> Vector:
        largest = np.array(self._motion.max_acceleration)
        return np.clip(acceleration, -largest, largest)

    def _at_ticks(self, new: Answer) -> Answer:
        """Return an answer with a row for each tick."""
        ticks = max(1, round((new.end_s - new.starts_s) / self._tick_s))
        times_s = new.starts_s + self._tick_s * np.arange(ticks)
        targets = np.array([new.target_at(each) for each in times_s])
        torques = np.array([new.torque_at(each) for each in times_s])
        is_held = len(new.torques) == 1
        return replace(
            new, period_s=self._tick_s, targets=targets, torques=new.torques if is_held else torques
        )

    def _to_reachable(self, targets: Matrix, new: Answer, now_s: float) -> tuple[Any, int]:
        """Return a curve to the first reachable row, and the number of that row."""
        for row in range(1, len(targets)):
            curve = self._ruckig.Trajectory(len(self._motion.max_jerk))
            self._motion.target_position, self._motion.target_velocity = targets[row].tolist()
            acceleration = new.acceleration_at(now_s + row * self._tick_s)
            self._motion.target_acceleration = self._within_limits(acceleration).tolist()
            self._motion.minimum_duration = None
            if self._generator.calculate(self._motion, curve) < 0:
                continue
            if curve.duration <= row * self._tick_s:
                self._motion.minimum_duration = row * self._tick_s
                self._generator.calculate(self._motion, curve)
                return curve, row
        return None, 0


class SplineSettings(MergeSettings):
    """A jerk-limited curve from the motion in force to the new chunk.

    Attributes:
        acceleration_rad_s2: largest acceleration of each joint.
        jerk_rad_s3: largest jerk of each joint.
    """

    acceleration_rad_s2: Positive = 20.0
    jerk_rad_s3: Positive = 500.0

    def problem(self, timing: ChunkTiming) -> str:  # noqa: ARG002
        return "" if find_spec("ruckig") else needs_extra("ruckig", "policies")

    def build(self, timing: ChunkTiming) -> Spline:
        return Spline(timing, self.acceleration_rad_s2, self.jerk_rad_s3)
