"""The control laws by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bus_schema.arrays import Vector
from bus_schema.errors import did_you_mean
from bus_schema.registry import Registry
from controller.control_law import ControlLaw, Dynamics
from controller.laws.computed_torque import ComputedTorque, ComputedTorqueGains
from controller.laws.disturbance_observer import DisturbanceObserver, DisturbanceObserverGains
from controller.laws.fixed_time_adaptive import FixedTimeAdaptive, FixedTimeAdaptiveGains
from controller.laws.fixed_time_model_based import FixedTimeModelBased, FixedTimeModelBasedGains
from controller.laws.fixed_time_neural import FixedTimeNeural, FixedTimeNeuralGains
from controller.laws.funnel_control import FunnelControl, FunnelControlGains
from controller.laws.joint_impedance import JointImpedance, JointImpedanceGains
from controller.laws.pid import Pid, PidGains, PidGravity, PidGravityGains
from controller.laws.ppc_delay import PpcDelay, PpcDelayGains
from controller.laws.settling import LargestInertia, settling_bound_s
from controller.laws.sliding_mode import FtsmcGains, SlidingMode, SmcGains, TsmcGains
from controller.laws.slotine_li import SlotineLi, SlotineLiGains
from controller.laws.super_twisting import SuperTwisting, SuperTwistingGains
from controller.laws.time_delay_control import TimeDelayControl, TimeDelayControlGains
from controller.outer_laws.position_correction import PositionCorrection, PositionCorrectionGains
from controller.outer_laws.proportional_velocity import (
    ProportionalVelocity,
    ProportionalVelocityGains,
)
from controller.outer_laws.streaming import Streaming, StreamingGains


@dataclass(frozen=True)
class LawEntry:
    """One entry of `LAWS`.

    Attributes:
        build: returns a new law from its gains, a nominal model, which model-free laws ignore, and
            torque limits, shape (joints,), N m, at which a law with a memory stops integrating.
        gains: the type of its gains: a NamedTuple of values as `bus_schema.configuration` has them,
            which can derive itself by `from_inertia`.
        settling_bound_s: bound on the settling time, s; only for laws that have one.
        gives: ``torque``, or what else its commands contain for robots that take no torque:
            ``position``, ``velocity`` or ``motion``, which is both.
        with_gravity: the same law with a gravity term; only for laws that lack one.

    Raises:
        TypeError: the gains are no such type.
    """

    build: Callable[[Any, Dynamics, Vector], ControlLaw]
    gains: Any
    settling_bound_s: Callable[[Any, LargestInertia], float] | None = None
    gives: str = "torque"
    with_gravity: str | None = None

    def __post_init__(self) -> None:
        if not (hasattr(self.gains, "_fields") and hasattr(self.gains, "from_inertia")):
            raise TypeError("gains must be a NamedTuple with a method from_inertia")


_SHIPPED = {
    "fixed_time_neural": LawEntry(FixedTimeNeural, FixedTimeNeuralGains, settling_bound_s),
    "fixed_time_model_based": LawEntry(
        FixedTimeModelBased, FixedTimeModelBasedGains, settling_bound_s
    ),
    "fixed_time_adaptive": LawEntry(FixedTimeAdaptive, FixedTimeAdaptiveGains, settling_bound_s),
    "pid": LawEntry(Pid, PidGains, with_gravity="pid_gravity"),
    "pid_gravity": LawEntry(PidGravity, PidGravityGains),
    "smc": LawEntry(SlidingMode, SmcGains),
    "tsmc": LawEntry(SlidingMode, TsmcGains),
    "ftsmc": LawEntry(SlidingMode, FtsmcGains),
    "super_twisting": LawEntry(SuperTwisting, SuperTwistingGains),
    "computed_torque": LawEntry(ComputedTorque, ComputedTorqueGains),
    "slotine_li": LawEntry(SlotineLi, SlotineLiGains),
    "joint_impedance": LawEntry(JointImpedance, JointImpedanceGains),
    "time_delay_control": LawEntry(TimeDelayControl, TimeDelayControlGains),
    "disturbance_observer": LawEntry(DisturbanceObserver, DisturbanceObserverGains),
    "funnel_control": LawEntry(FunnelControl, FunnelControlGains),
    "ppc_delay": LawEntry(PpcDelay, PpcDelayGains),
    "streaming": LawEntry(Streaming, StreamingGains, gives="motion"),
    "proportional_velocity": LawEntry(
        ProportionalVelocity, ProportionalVelocityGains, gives="velocity"
    ),
    "position_correction": LawEntry(PositionCorrection, PositionCorrectionGains, gives="position"),
}
LAWS: Registry[LawEntry] = Registry("laws", "controller.law", LawEntry, _SHIPPED)
"""The laws of scenarios (``controller.law``, ``controller.gains``), ``--laws`` and studies."""

TORQUE_LAWS = [name for name, entry in _SHIPPED.items() if entry.gives == "torque"]
"""Shipped laws that drive any arm; the others need a robot with a controller of its own."""

COMPARED_LAWS = [
    "fixed_time_neural", "fixed_time_model_based", "fixed_time_adaptive", "pid", "smc", "tsmc",
    "ftsmc",
]  # fmt: skip
"""The laws that a command compares if none are named: the paper's and the default law."""


def likely_law(unknown: str) -> str:
    """Return ``; did you mean …?`` if a name resembles a law's; else nothing."""
    return did_you_mean(unknown, LAWS)


def torque_laws() -> list[str]:
    """Return all laws that drive any arm, also those of packages that are installed."""
    return [name for name, entry in LAWS.usable().items() if entry.gives == "torque"]
