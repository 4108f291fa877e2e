"""Faults that a scenario schedules and the plant emulates: what breaks, when, and for how long."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bus_schema.configuration import NonNegative, Positive, StrictModel

FOREVER_NS = 1 << 62
Share = Annotated[float, Field(gt=0, le=1)]


class Fault(StrictModel):
    """What every fault has.

    Attributes:
        kind: which fault.
        at_s: when it begins, on the run's clock.
        for_s: how long it lasts; to the end of the run if left out.
    """

    kind: str
    at_s: NonNegative
    for_s: Positive | None = None

    @property
    def start_ns(self) -> int:
        return round(self.at_s * 1e9)

    @property
    def end_ns(self) -> int:
        return FOREVER_NS if self.for_s is None else round((self.at_s + self.for_s) * 1e9)

    def is_active(self, now_ns: int) -> bool:
        return self.start_ns <= now_ns < self.end_ns

    def __str__(self) -> str:
        """The fault in a few words: its kind, and the values that are its own."""
        common = ("kind", "at_s", "for_s")
        own = [f"{key} {value}" for key, value in self if key not in common and value is not None]
        return ", ".join([self.kind, *own])


class JointFault(Fault):
    """Attributes: joint: name of the joint."""

    joint: str


class EncoderStuck(JointFault):
    """Shows the position it showed first, and no velocity."""

    kind: Literal["encoder_stuck"]


class EncoderBiased(JointFault):
    """Attributes: bias_rad: what is added to the position."""

    kind: Literal["encoder_biased"]
    bias_rad: float


class EncoderNoisy(JointFault):
    """Attributes: noise_rad, noise_rad_s: standard deviations of white noise that is added."""

    kind: Literal["encoder_noisy"]
    noise_rad: NonNegative = 0.0
    noise_rad_s: NonNegative = 0.0


class TorqueOffset(JointFault):
    """Attributes: torque_nm: what the actuator adds to the torque asked for."""

    kind: Literal["torque_offset"]
    torque_nm: float


class ActuatorWeak(JointFault):
    """Attributes: share: what the actuator delivers of the torque asked for."""

    kind: Literal["actuator_weak"]
    share: Share


class ActuatorDead(JointFault):
    """Delivers nothing."""

    kind: Literal["actuator_dead"]


class PayloadDropped(Fault):
    """The payload of ``plant.payload_kg`` falls off, for good."""

    kind: Literal["payload_dropped"]
    for_s: None = None


class LinkFault(Fault):
    """Attributes: direction: of the link."""

    direction: Literal["uplink", "downlink"]


class LinkCut(LinkFault):
    """Loses every message."""

    kind: Literal["link_cut"]


class LinkSlowed(LinkFault):
    """Attributes: delay_ms: added to the delay of every message."""

    kind: Literal["link_slowed"]
    delay_ms: Positive


class LinkDuplicated(LinkFault):
    """Attributes: share: probability that a message comes twice."""

    kind: Literal["link_duplicated"]
    share: Share = 1.0


class LinkCorrupted(LinkFault):
    """A message comes cut off at a random byte; nobody can read it.

    Attributes:
        share: probability that this becomes of a message.
    """

    kind: Literal["link_corrupted"]
    share: Share = 1.0


class NonFiniteCommand(Fault):
    """Every command reads NaN for the torque of one joint, as from a law that divides by zero."""

    kind: Literal["non_finite_command"]


class SecondCommander(Fault):
    """Somebody else answers every state too, in his own name, just before the controller does.

    Attributes:
        torque_nm: what he asks of every joint.
    """

    kind: Literal["second_commander"]
    torque_nm: float


class ClockStep(Fault):
    """The clock of one side leaps: the stamps that it writes are wrong.

    Attributes:
        side: whose clock; that of the plant stamps states, that of the controller commands.
        step_ms: by how much.
    """

    kind: Literal["clock_step"]
    side: Literal["plant", "controller"]
    step_ms: float

    @property
    def step_ns(self) -> int:
        return round(self.step_ms * 1e6)


ArmFault = (
    EncoderStuck | EncoderBiased | EncoderNoisy | TorqueOffset | ActuatorWeak | ActuatorDead
    | PayloadDropped
)  # fmt: skip
ChannelFault = LinkCut | LinkSlowed | LinkDuplicated
MessageFault = LinkCorrupted | NonFiniteCommand | SecondCommander | ClockStep
PlantFault = ArmFault | ChannelFault | MessageFault
