"""Faults of the arm's hardware: encoders with wrong readings, actuators with wrong torques."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import ConfigurationError, NonNegative, Number, Positive
from plant_emulator.faults.fault import Fault, FaultContext, FaultScheduler, ScheduledAction, Share


class ArmHardware(Protocol):
    """The arm as a whole, as faults change it: `plant_emulator.physics.engine.ArmPhysics`."""

    payload_kg: float

    def carry(self, payload_kg: float) -> None: ...


class ArmFault(Fault):
    """A fault of the arm."""

    def begin(self, arm: ArmHardware, _now_ns: int) -> None:
        """Apply the fault's one-time effect at its beginning."""


class JointFault(ArmFault):
    """Attributes: joint: name of the joint."""

    joint: str

    def check(self, key: str, context: FaultContext) -> None:
        super().check(key, context)
        if self.joint not in context.joint_names:
            allowed = f"one of {', '.join(context.joint_names)}"
            raise ConfigurationError(f"{key}.joint", self.joint, allowed)


class EncoderFault(JointFault):
    """A fault of the encoder of a joint."""

    @abstractmethod
    def faulty(self, now: Vector, first: Vector, random: np.random.Generator) -> ArrayLike:
        """Return the encoder's reading while the fault lasts: position, rad, and velocity, rad/s.

        Args:
            now: the correct reading, shape (2,).
            first: the correct reading at the beginning of the fault.
            random: source of noise, drawn from the scenario's seed.
        """


class ActuatorFault(JointFault):
    """A fault of the actuator of a joint."""

    @abstractmethod
    def faulty_torque_nm(self, requested_nm: float) -> float:
        """Return the torque delivered for the requested one while the fault lasts."""


class EncoderStuck(EncoderFault):
    """The encoder keeps reporting the position at the start of the fault, and zero velocity."""

    kind: Literal["encoder_stuck"]

    def faulty(self, _now: Vector, first: Vector, _random: np.random.Generator) -> ArrayLike:
        return first[0], 0.0


class EncoderBiased(EncoderFault):
    """Attributes: bias_rad: offset of the position."""

    kind: Literal["encoder_biased"]
    bias_rad: Number

    def faulty(self, now: Vector, _first: Vector, _random: np.random.Generator) -> ArrayLike:
        return now[0] + self.bias_rad, now[1]


class EncoderNoisy(EncoderFault):
    """Attributes: noise_rad, noise_rad_s: standard deviations of white noise that is added."""

    kind: Literal["encoder_noisy"]
    noise_rad: NonNegative = 0.0
    noise_rad_s: NonNegative = 0.0

    def faulty(self, now: Vector, _first: Vector, random: np.random.Generator) -> ArrayLike:
        return now + random.standard_normal(2) * (self.noise_rad, self.noise_rad_s)


class TorqueOffset(ActuatorFault):
    """Attributes: torque_nm: offset of the actuator's torque."""

    kind: Literal["torque_offset"]
    torque_nm: Number

    def faulty_torque_nm(self, requested_nm: float) -> float:
        return requested_nm + self.torque_nm


class ActuatorWeak(ActuatorFault):
    """Attributes: share: share of the requested torque that the actuator delivers."""

    kind: Literal["actuator_weak"]
    share: Share

    def faulty_torque_nm(self, requested_nm: float) -> float:
        return requested_nm * self.share


class ActuatorDead(ActuatorFault):
    """The actuator delivers no torque."""

    kind: Literal["actuator_dead"]

    def faulty_torque_nm(self, _requested_nm: float) -> float:
        return 0.0


class PayloadFault(ArmFault):
    """A fault that changes the arm's payload for good."""

    for_s: None = None

    @abstractmethod
    def payload_after_kg(self, carried_kg: float) -> float:
        """Return the arm's new payload, given the one before."""

    def begin(self, arm: ArmHardware, _now_ns: int) -> None:
        arm.carry(self.payload_after_kg(arm.payload_kg))


class PayloadPickedUp(PayloadFault):
    """Attributes: payload_kg: point mass added to the tip's payload."""

    kind: Literal["payload_picked_up"]
    payload_kg: Positive

    def payload_after_kg(self, carried_kg: float) -> float:
        return carried_kg + self.payload_kg


class PayloadDropped(PayloadFault):
    """The tip loses its whole payload."""

    kind: Literal["payload_dropped"]

    def payload_after_kg(self, _carried_kg: float) -> float:
        return 0.0

    def check(self, key: str, context: FaultContext) -> None:
        super().check(key, context)
        if context.payload_kg == 0.0:
            allowed = "needs a payload to drop: plant.payload_kg must be above 0"
            raise ConfigurationError(f"{key}.kind", self.kind, allowed)


def payload_steps(payload_kg: float, faults: Iterable[Fault]) -> list[tuple[float, float]]:
    """Return an arm's payloads over a run: start time, s, and mass, kg; the first at 0 s.

    Args:
        payload_kg: its payload at the start.
        faults: all of the run.
    """
    steps = [(0.0, payload_kg)]
    changes = (fault for fault in faults if isinstance(fault, PayloadFault))
    for fault in sorted(changes, key=lambda fault: fault.start_ns):
        steps.append((fault.at_s, fault.payload_after_kg(steps[-1][1])))
    return steps


class ArmFaults:
    """The faults of an arm; if two affect one joint, the later in the scenario is applied last.

    Args:
        faults: all faults of the plant; those of other parts are ignored.
        joint_names: names of the joints.
        random: source of an encoder's noise.
        arm: the arm as a whole.
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        joint_names: tuple[str, ...],
        random: np.random.Generator,
        arm: ArmHardware,
    ) -> None:
        self._encoder_faults = [fault for fault in faults if isinstance(fault, EncoderFault)]
        self._actuator_faults = [fault for fault in faults if isinstance(fault, ActuatorFault)]
        self._joint = {name: joint for joint, name in enumerate(joint_names)}
        self._random = random
        self._first: dict[int, Vector] = {}
        self._beginnings = FaultScheduler(
            ScheduledAction(fault.start_ns, str(fault), partial(fault.begin, arm))
            for fault in faults
            if isinstance(fault, ArmFault)
        )

    def begin_due(self, now_ns: int) -> None:
        """Apply the one-time effects of faults that begin now."""
        self._beginnings.run_due(now_ns)

    def faulty_torques(self, commanded_nm: Vector, now_ns: int) -> Vector:
        """Return the torques that actuators deliver for commanded ones, N m, shape (joints,)."""
        requested_nm = commanded_nm.copy()
        for fault in self._actuator_faults:
            if fault.is_active(now_ns):
                joint = self._joint[fault.joint]
                requested_nm[joint] = fault.faulty_torque_nm(float(requested_nm[joint]))
        return requested_nm

    def spoil_readings(self, motion: Matrix, now_ns: int) -> None:
        """Replace the readings of faulty encoders.

        Args:
            motion: positions, rad, and velocities, rad/s, as rows; changed in place.
            now_ns: time on the plant's clock.
        """
        for index, fault in enumerate(self._encoder_faults):
            if fault.is_active(now_ns):
                joint = self._joint[fault.joint]
                reading = motion[:, joint].copy()
                first = self._first.setdefault(index, reading)
                motion[:, joint] = fault.faulty(reading, first, self._random)
