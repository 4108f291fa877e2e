"""``joint_trajectory``: each message is a point that the joints reach some time later.

After ros2_controllers' joint_trajectory_controller: the controller samples the trajectory one cycle
ahead. Each new message starts at the measured state, unless ``interpolate_from_desired_state`` is
set: then at the trajectory's own. A robot that lags is pulled back to where it is by each message.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import Positive
from plant_emulator.interfaces.interface import Motion, Stoppable
from plant_emulator.interfaces.response import Response
from plant_emulator.interfaces.settings import ResponseSettings


class JointTrajectory(Stoppable):
    """Points with positions, or with positions and velocities, reached after a set time.

    Args:
        period_s: of a cycle.
        response: of the joints.
        point_after_s: time from a message until the joints reach its point.
        is_cubic: splines take the velocities too; lines otherwise.
        from_desired: new messages start at the trajectory's state, not at the measured one.

    Attributes:
        planned: the trajectory's position and velocity of this cycle, as rows, shape (2, joints).
    """

    def __init__(
        self, period_s: float, response: Response, point_after_s: float, *, is_cubic: bool,
        from_desired: bool,
    ) -> None:  # fmt: skip
        self._period_s, self._response, self._after_s = period_s, response, point_after_s
        self._is_cubic, self._from_desired = is_cubic, from_desired

    def start(self, position_rad: Vector) -> None:
        self._response.start(position_rad)
        self.planned: Matrix = np.stack([position_rad, np.zeros(position_rad.size)])
        self._begin, self._end = self.planned.copy(), self.planned.copy()
        self._passed_s = self._after_s

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:
        if target is not None:
            self._begin = (self.planned if self._from_desired else measured).copy()
            self._end, self._passed_s = target.copy(), 0.0
        self._passed_s += self._period_s
        self.planned = self._sample(min(1.0, self._passed_s / self._after_s))
        return self._response.step(self.planned)

    def _sample(self, share: float) -> Matrix:
        """Return position and velocity at a share of the way, shape (2, joints)."""
        (start, v0), (end, v1), whole_s = self._begin, self._end, self._after_s
        moved = end - start
        if share >= 1.0:
            return np.stack([end, np.zeros_like(end)])
        if not self._is_cubic:
            return np.stack([start + share * moved, moved / whole_s])
        c2 = 3.0 * moved - (2.0 * v0 + v1) * whole_s
        c3 = (v0 + v1) * whole_s - 2.0 * moved
        place = start + share * (v0 * whole_s + share * (c2 + share * c3))
        return np.stack([place, v0 + share * (2.0 * c2 + 3.0 * share * c3) / whole_s])


class JointTrajectorySettings(ResponseSettings):
    """Points of a trajectory, as ros2_controllers' joint_trajectory_controller takes them.

    Attributes:
        point_after_ms: time from a message until the joints reach its point.
        interpolation: ``cubic`` with the velocities of points, or ``linear`` without.
        interpolate_from_desired_state: new messages start at the trajectory's own state.
    """

    rate_hz: ClassVar[float] = 500.0
    goes_on: ClassVar[bool] = True
    usual_ms: ClassVar[tuple[float, float]] = (0.0, 20.0)
    point_after_ms: Positive = 10.0
    interpolation: Literal["linear", "cubic"] = "cubic"
    interpolate_from_desired_state: bool = False

    def lag_s(self, period_s: float, targets_s: float) -> float | None:
        """Return the lag with which a cycle moves the joints as far as their target moves.

        From the measured state, L behind at speed v, a cycle of length h plans the step h v + (L −
        T) s v with cubics, s = 3x² − 2x³ and x = h / T, or x L v with lines. This is ahead by the
        lag of the response. From the trajectory's own state, that step is h v: L = T.
        """
        whole_s, behind_s = max(1e-3 * self.point_after_ms, period_s), self.response_lag_s(period_s)
        if self.interpolate_from_desired_state:
            return whole_s - period_s + behind_s if targets_s <= whole_s else None
        if targets_s > period_s:
            return None
        share = period_s / whole_s
        if self.interpolation == "linear":
            return behind_s / share
        return whole_s + (behind_s - period_s) / (share * share * (3.0 - 2.0 * share))

    def build(self, period_s: float) -> JointTrajectory:
        return JointTrajectory(
            period_s, self.response(period_s), 1e-3 * self.point_after_ms,
            is_cubic=self.interpolation == "cubic",
            from_desired=self.interpolate_from_desired_state,
        )  # fmt: skip
