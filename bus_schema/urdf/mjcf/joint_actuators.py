"""Effects of actuators at their joint, and attributes that are not carried over."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from bus_schema.arrays import Vector

_MOST_SHOWN = 6
LEFT_OUT = "it is left out"


@dataclass
class JointActuators:
    """Effect of a joint's actuators, in rad and N m, or m and N where it slides.

    Attributes:
        effort: largest torque; inf without a limit.
        velocity: largest speed, of velocity servos and at the voltage of motors.
        lower: lower end of the range of the joint and of its position servos.
        upper: upper end.
        stiffness: of position servos, per rad.
        damping: of all servos, per rad/s.
        rotor_inertia: kg m².
        viscous: friction per rad/s.
        coulomb: dry friction.
        stribeck: dry friction beyond that near standstill.
        stribeck_velocity: speed over which that decays, rad/s.
        delay: dead time, s.
        lag: time constant, s.
        stall: largest torque at standstill of motors whose torque falls with speed.
        no_load_speed: at this speed there is no torque; 0 for no such speed.
        cogging: amplitude of the cogging torque.
        cogging_periods: periods of that torque per turn of the joint.
    """

    effort: float = 0.0
    velocity: float = math.inf
    lower: float = -math.inf
    upper: float = math.inf
    stiffness: float = 0.0
    damping: float = 0.0
    rotor_inertia: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    stribeck: float = 0.0
    stribeck_velocity: float = 0.0
    delay: float = 0.0
    lag: float = 0.0
    stall: float = 0.0
    no_load_speed: float = 0.0
    cogging: float = 0.0
    cogging_periods: float = 0.0

    @property
    def rated_speed(self) -> float:
        """Up to this speed the largest torque is available, rad/s; 0 without a no-load speed."""
        return self.no_load_speed * max(0.0, 1.0 - self.effort / self.stall) if self.stall else 0.0

    def limit_range(self, ends: Vector) -> None:
        """Keep the part of the range that lies between both ends."""
        self.lower, self.upper = max(self.lower, ends.min()), min(self.upper, ends.max())

    def limit_speed(self, ends: Vector) -> None:
        """Keep the speeds that both ends allow."""
        self.velocity = min(self.velocity, float(abs(ends).max()))


class Omissions:
    """Attributes of a file's drives that are not carried over, with the reasons."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, str], dict[str, int | None]] = {}

    def add(
        self, attribute: str, name: str, reason: str = LEFT_OUT, joint: int | None = None
    ) -> None:
        """Note an attribute of an actuator or joint.

        Args:
            attribute: the attribute.
            name: of the actuator or joint.
            reason: what becomes of it.
            joint: number of the joint that it concerns; None for all.
        """
        self._names.setdefault((attribute, reason), {})[name] = joint

    def sentences(self, joints: Collection[int]) -> Iterator[str]:
        """Return a sentence for each attribute and reason, as far as it concerns some joints."""
        for (attribute, reason), noted in self._names.items():
            names = [name for name, joint in noted.items() if joint is None or joint in joints]
            shown = ", ".join(names[:_MOST_SHOWN]) + ", …" * (len(names) > _MOST_SHOWN)
            if names:
                yield f"{attribute} of {shown}: {reason}"
