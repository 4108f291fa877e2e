"""Motion that clients start and stop; in between, the robot brakes and holds its position."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.interfaces.interface import (
    FreeTorque,
    Motion,
    Reflex,
    RobotInterface,
    Stoppable,
)
from plant_emulator.interfaces.velocity_integrator import VelocityIntegrator

_REST_RAD_S = 1e-9


class ClientMotion(Stoppable):
    """An interface while it has begun, braking and rest otherwise.

    A reflex of the interface ends its motion, not that of the run: `reflex` stays None.

    Args:
        period_s: of a cycle.
        stop_rad_s2: deceleration of stops.

    Attributes:
        ended_by: the reflex that ended the last motion; None if none did.
        target: the newest target; None before the first of a motion.
        is_running: whether the interface has begun; it waits for the client's first message.
    """

    def __init__(self, period_s: float, stop_rad_s2: float) -> None:
        self._period_s, self._most_rad_s = period_s, stop_rad_s2 * period_s
        self._joints = VelocityIntegrator(period_s)
        self._joints.start(np.zeros(0))
        self._interface: RobotInterface | None = None
        self._waiting: Matrix | None = None
        self.target: Matrix | None = None
        self.is_running = False
        self.ended_by: Reflex | None = None

    def start(self, position_rad: Vector) -> None:
        """Begin at rest."""
        self._joints.start(position_rad)

    @property
    def planned(self) -> Matrix:
        """Position and velocity that are planned now, as rows, shape (2, joints)."""
        return np.stack([self._joints.position, self._joints.velocity])

    @property
    def target_rad(self) -> Vector:
        """Position of the newest target, shape (joints,); NaN without one."""
        if self.target is None:
            return np.full(self._joints.position.size, np.nan)
        position: Vector = self.target[0]
        return position

    @property
    def is_moved(self) -> bool:
        """Whether an interface moves the robot."""
        return self._interface is not None

    @property
    def is_at_rest(self) -> bool:
        """Whether the robot holds its position."""
        return not self.is_moved and not (np.abs(self._joints.velocity) > _REST_RAD_S).any()

    def begin(self, interface: RobotInterface) -> None:
        """Let an interface move the robot from rest, once its client sends something."""
        interface.start(self._joints.position.copy())
        self._interface, self.ended_by = interface, None
        self._waiting, self.target, self.is_running = None, None, False

    def run(self) -> None:
        """Run from the next cycle on, also without a target."""
        self.is_running = self._interface is not None

    def put(self, target: Matrix) -> None:
        """Note a target for the next cycle."""
        self.run()
        if self._interface is not None:
            self._waiting = self.target = target

    def end(self) -> None:
        """Brake, from the next cycle on."""
        if self._interface is not None:
            self._joints.position = self._joints.position + self._period_s * self._joints.velocity
        self._interface = self._waiting = self.target = None
        self.is_running = False

    def step(self, target: Matrix | None, measured: Matrix) -> Motion | FreeTorque | Vector:  # noqa: ARG002
        if self._interface is None or not self.is_running:
            speed = self._joints.velocity
            return self._joints.change(-np.clip(speed, -self._most_rad_s, self._most_rad_s))
        found = self._interface.step(self._waiting, measured)
        self._waiting = None
        position, velocity = found[:2] if isinstance(found, Motion) else measured
        self._joints.position, self._joints.velocity = position.copy(), velocity.copy()
        self.ended_by = self._interface.reflex
        if self.ended_by is not None:
            self.end()
        return found
