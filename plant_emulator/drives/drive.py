"""The interface of an emulated drive, between its protocol and its joint.

Drives are passive: all times are arguments, and they have no thread and no clock. So the same
frames at the same instants give the same answers on every bus.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, NamedTuple, Protocol, TypeVar

from bus_schema.can.frame import CanFrame
from plant_emulator.drives.cascade import UNTUNED, CascadeGains

Send = Callable[[CanFrame], None]
"""Receives the frames that a drive sends."""


class JointReading(NamedTuple):
    """Sensor values of a drive."""

    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_nm: float = 0.0


class Loop(Protocol):
    """A loop that a drive closes around its joint between frames."""

    @property
    def is_closed(self) -> bool:
        """Whether the joint's motion changes the torque."""

    def torque_nm(self, position_rad: float, velocity_rad_s: float, step_s: float = 0.0) -> float:
        """Torque of the motor at the joint's position and velocity.

        Args:
            position_rad: what the encoder has of the joint, exactly; what the drive sees of it is
                rounded to its steps.
            velocity_rad_s: likewise.
            step_s: how long the torque is given from now on; 0 to ask only.
        """


class JointLoop(NamedTuple):
    """Stiffness and damping around a target.

    Attributes:
        target_rad: where the joint is to be.
        target_velocity_rad_s: how fast.
        stiffness_nm_rad: torque per rad off the target.
        damping_nm_s: torque per rad/s off it.
        feedforward_nm: torque beside that.
        step_rad: resolution of the drive's encoder.
        most_nm: the most torque there is.
    """

    target_rad: float
    target_velocity_rad_s: float
    stiffness_nm_rad: float
    damping_nm_s: float
    feedforward_nm: float
    step_rad: float
    most_nm: float

    @property
    def is_closed(self) -> bool:
        """Whether the joint's motion changes the torque."""
        return self.stiffness_nm_rad > 0.0 or self.damping_nm_s > 0.0

    def torque_nm(self, position_rad: float, velocity_rad_s: float, step_s: float = 0.0) -> float:  # noqa: ARG002
        """Torque of the motor at the joint's position and velocity."""
        seen_rad = round(position_rad / self.step_rad) * self.step_rad
        wanted = (
            self.feedforward_nm
            + self.stiffness_nm_rad * (self.target_rad - seen_rad)
            + self.damping_nm_s * (self.target_velocity_rad_s - velocity_rad_s)
        )
        return min(max(wanted, -self.most_nm), self.most_nm)


class JointDemand(NamedTuple):
    """Torque and brake of a drive.

    Attributes:
        torque_nm: torque of the motor, at the joint; 0 while the brake is engaged.
        is_released: power stage on and holding brake released.
        loop: gives the torque from now on; None if no motion of the joint changes it.
    """

    torque_nm: float
    is_released: bool
    loop: Loop | None = None


def following(loop: Loop, reading: JointReading) -> JointDemand:
    """The demand of a drive that closes a loop around its joint."""
    torque_nm = loop.torque_nm(reading.position_rad, reading.velocity_rad_s)
    return JointDemand(torque_nm, is_released=True, loop=loop if loop.is_closed else None)


AT_REST = JointDemand(0.0, is_released=False)
"""Power stage off, brake engaged."""


class DriveFault(StrEnum):
    """Faults that can be injected into a drive."""

    DRIVE = "drive"
    """Short circuit in the power stage; it ends when the power stage is off."""

    SILENT = "silent"
    """The bus connection is cut: the drive neither receives nor sends."""

    ENCODER_FROZEN = "encoder-frozen"
    """Position stays at its last value and velocity at zero; the drive does not notice."""

    OVER_TEMPERATURE = "over-temperature"
    """The motor is too hot."""

    ENCODER = "encoder"
    """The encoder cannot be read: position and velocity as with a frozen one; the drive notices."""


_LASTING = (DriveFault.ENCODER, DriveFault.OVER_TEMPERATURE)
"""Faults that a drive notices, and that no reset removes while their cause remains."""


Own = TypeVar("Own")


@dataclass(frozen=True)
class DriveSettings(Generic[Own]):
    """Settings of a drive for its joint; all values at the joint, without a gear.

    Attributes:
        node_id: address on the bus.
        max_torque_nm: largest torque of the drive.
        own: settings of its protocol alone, see `DriveProtocol.own_settings`.
        max_velocity_rad_s: highest target speed of its loops; CiA 402 drives have no limit.
        counts_per_turn: encoder resolution.
        lower_rad: lower end of the joint's range (-inf for none).
        upper_rad: upper end of the joint's range (inf for none).
        stop_damping_nm_s: torque per rad/s against the motion while the drive slows down.
        watchdog_ms: time without a frame after which the drive stops; 0 for never. CiA 402 drives
            have timeouts that the master sets instead.
        is_polled: a master requests the states, so the drive sends none without a request.
        gains: gains of its position and velocity loops, until a master sets others.
        fd_process_data: its frames in the cycle are CAN FD frames.
    """

    node_id: int
    max_torque_nm: float
    own: Own
    max_velocity_rad_s: float = float("inf")
    counts_per_turn: int = 1 << 20
    lower_rad: float = float("-inf")
    upper_rad: float = float("inf")
    stop_damping_nm_s: float = 20.0
    watchdog_ms: float = 0.0
    is_polled: bool = False
    fd_process_data: bool = False
    gains: CascadeGains = UNTUNED


class Cycle:
    """A periodic event; never due if its period is 0.

    Args:
        period_ns: time between two of them.
        first_ns: when it happens first.
    """

    def __init__(self, period_ns: int, first_ns: int = 0) -> None:
        self._period_ns, self._next_ns = period_ns, first_ns

    def is_due(self, now_ns: int) -> bool:
        """Return whether the event is due, and schedule the next one."""
        if now_ns < self._next_ns or not self._period_ns:
            return False
        self._next_ns += ((now_ns - self._next_ns) // self._period_ns + 1) * self._period_ns
        return True


def _ignore() -> None:
    """Do nothing."""


class Drive(ABC, Generic[Own]):
    """One axis of one protocol.

    A drive defines `targets` and `samplings` as class attributes or properties.

    Args:
        settings: how it is commissioned.
        send: takes the frames that it sends.

    Attributes:
        identifiers: identifiers of the frames for this drive.
        on_set_up: called when `identifiers` has changed.
        is_silent: its bus connection is cut.
        targets_taken: targets that the bank has counted.
        most_bytes: of a frame that it may take.
        takes_extended: it takes frames with 29-bit identifiers, too.
    """

    most_bytes, takes_extended = 8, False

    identifiers: Collection[int]

    def __init__(self, settings: DriveSettings[Own], send: Send) -> None:
        self._settings, self._send = settings, send
        self.on_set_up: Callable[[], None] = _ignore
        self._reading = JointReading()
        self._is_off_bus = self.is_silent = False
        self._causes: set[DriveFault] = set()
        self.targets_taken = 0

    @property
    @abstractmethod
    def targets(self) -> int:
        """Number of targets (torques) accepted so far."""

    @property
    @abstractmethod
    def samplings(self) -> int:
        """Number of samplings for the controller, on SYNC or on its request."""

    @property
    @abstractmethod
    def status(self) -> str:
        """The drive's state, in the protocol's terms."""

    @property
    def fault(self) -> str | None:
        """The drive's fault; None without one."""
        return None

    def measure(self, reading: JointReading) -> None:
        """Set the sensor values that hold from now on."""
        self._reading = reading

    @abstractmethod
    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        """Receive a data or remote frame; return whether it was for this drive.

        Raises:
            InvalidMessageError: it was, and makes no sense. Nothing has changed.
        """

    @abstractmethod
    def advance(self, now_ns: int) -> None:
        """Process due events: boot, cyclic frames, timeouts, the end of a slow-down."""

    @abstractmethod
    def demand(self) -> JointDemand:
        """Return the present torque and brake."""

    def seen(self, position_rad: float, velocity_rad_s: float) -> tuple[float, float]:
        """Return what the encoder measures of a motion."""
        if not self._causes.isdisjoint((DriveFault.ENCODER_FROZEN, DriveFault.ENCODER)):
            return self._reading.position_rad, 0.0
        return position_rad, velocity_rad_s

    def inject(self, fault: DriveFault, now_ns: int) -> None:
        """Inject a fault."""
        self._causes.add(fault)
        self.is_silent = DriveFault.SILENT in self._causes
        if fault is DriveFault.DRIVE or fault in _LASTING:
            self._fail(fault, now_ns)

    def clear(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (some need the time)
        """Remove a lasting fault's cause; its consequences stay until they are reset."""
        self._causes.discard(fault)
        self.is_silent = DriveFault.SILENT in self._causes

    @property
    def _is_hot(self) -> bool:
        return DriveFault.OVER_TEMPERATURE in self._causes

    @property
    def _lasting_fault(self) -> DriveFault | None:
        """Fault that a reset cannot remove yet; None for none."""
        return next((fault for fault in _LASTING if fault in self._causes), None)

    @abstractmethod
    def _fail(self, fault: DriveFault, now_ns: int) -> None:
        """React to ``DRIVE`` or a fault of `_LASTING`, those that a drive notices."""

    def lose_bus(self, now_ns: int) -> None:  # noqa: ARG002 (some need the time)
        """The drive's CAN controller went bus-off. Most drives notice by their timeout only."""
        self._is_off_bus = True

    def regain_bus(self, now_ns: int) -> None:  # noqa: ARG002 (some need the time)
        """The drive's CAN controller is back on the bus."""
        self._is_off_bus = False

    def describe(self, frame: CanFrame) -> str | None:  # noqa: ARG002 (a protocol may have none)
        """Describe a frame in words; None if it is not between a master and this drive."""
        return None

    def _transmit(self, frame: CanFrame) -> None:
        if not (self._is_off_bus or self.is_silent):
            self._send(frame)
