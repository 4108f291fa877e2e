"""Faults of the arm's hardware: encoders that show, and actuators that give, something else."""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal, NamedTuple, Protocol

import numpy as np

from bus_schema.configuration import ConfigurationError, NonNegative
from plant_emulator.faults.fault import Fault, FaultContext, Share


class ArmHardware(Protocol):
    """What a fault can do to the arm as a whole."""

    def drop_payload(self) -> None:
        """Take the payload off for good."""


class EncoderReading(NamedTuple):
    """What an encoder shows."""

    position_rad: float
    velocity_rad_s: float


class FaultyEncoder(NamedTuple):
    """An encoder as a fault finds it.

    Attributes:
        reading: what it would show now.
        first: what it would have shown when the fault began.
        random: source of noise, drawn from the scenario's seed.
    """

    reading: EncoderReading
    first: EncoderReading
    random: np.random.Generator


class ArmFault(Fault):
    """A fault of the arm."""

    def begin(self, arm: ArmHardware) -> None:
        """Do what is done once, at the beginning."""


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
    def faulty_reading(self, encoder: FaultyEncoder) -> EncoderReading:
        """What the encoder shows while the fault lasts."""


class ActuatorFault(JointFault):
    """A fault of the actuator of a joint."""

    @abstractmethod
    def faulty_torque_nm(self, requested_nm: float) -> float:
        """What the actuator takes for the torque requested while the fault lasts."""


class EncoderStuck(EncoderFault):
    """Shows the position it showed first, and no velocity."""

    kind: Literal["encoder_stuck"]

    def faulty_reading(self, encoder: FaultyEncoder) -> EncoderReading:
        return EncoderReading(encoder.first.position_rad, 0.0)


class EncoderBiased(EncoderFault):
    """Attributes: bias_rad: what is added to the position."""

    kind: Literal["encoder_biased"]
    bias_rad: float

    def faulty_reading(self, encoder: FaultyEncoder) -> EncoderReading:
        position_rad, velocity_rad_s = encoder.reading
        return EncoderReading(position_rad + self.bias_rad, velocity_rad_s)


class EncoderNoisy(EncoderFault):
    """Attributes: noise_rad, noise_rad_s: standard deviations of white noise that is added."""

    kind: Literal["encoder_noisy"]
    noise_rad: NonNegative = 0.0
    noise_rad_s: NonNegative = 0.0

    def faulty_reading(self, encoder: FaultyEncoder) -> EncoderReading:
        position_rad, velocity_rad_s = encoder.reading
        noise = encoder.random.standard_normal(2).tolist()
        return EncoderReading(
            position_rad + self.noise_rad * noise[0], velocity_rad_s + self.noise_rad_s * noise[1]
        )


class TorqueOffset(ActuatorFault):
    """Attributes: torque_nm: what the actuator adds to the torque requested."""

    kind: Literal["torque_offset"]
    torque_nm: float

    def faulty_torque_nm(self, requested_nm: float) -> float:
        return requested_nm + self.torque_nm


class ActuatorWeak(ActuatorFault):
    """Attributes: share: what the actuator delivers of the torque requested."""

    kind: Literal["actuator_weak"]
    share: Share

    def faulty_torque_nm(self, requested_nm: float) -> float:
        return requested_nm * self.share


class ActuatorDead(ActuatorFault):
    """Delivers nothing."""

    kind: Literal["actuator_dead"]

    def faulty_torque_nm(self, _requested_nm: float) -> float:
        return 0.0


class PayloadDropped(ArmFault):
    """The payload of ``plant.payload_kg`` falls off, for good."""

    kind: Literal["payload_dropped"]
    for_s: None = None

    def begin(self, arm: ArmHardware) -> None:
        arm.drop_payload()

    def check(self, key: str, context: FaultContext) -> None:
        super().check(key, context)
        if context.payload_kg == 0.0:
            allowed = "there is nothing to drop: plant.payload_kg must be above 0"
            raise ConfigurationError(f"{key}.kind", self.kind, allowed)
