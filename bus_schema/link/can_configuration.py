"""Section ``link.can`` of a scenario: the CAN bus, its drives, and how they are monitored."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    Number,
    PerJointPositive,
    Positive,
    StrictModel,
    Whole,
)
from bus_schema.registry import NameIn

_DESCRIPTIONS = Path(str(resources.files("bus_schema").joinpath("can")))
CIA402_EDS = _DESCRIPTIONS / "cia402/cia402_drive.eds"
CANSIMPLE_DBC = _DESCRIPTIONS / "cansimple/cansimple.dbc"
"""Descriptions of the drives' protocols, for both sides."""

_CHANNELS = {"udp_multicast": "239.74.163.2", "virtual": "funnel_hil"}


def _check_node_ids(node_ids: tuple[int, ...]) -> tuple[int, ...]:
    repeated = sorted({each for each in node_ids if node_ids.count(each) > 1})
    if repeated:
        raise ValueError(f"numbers that are all different; given more than once: {repeated}")
    return node_ids


NodeId = Annotated[Whole, Field(ge=1, le=127)]


class CanFaults(StrictModel):
    """Injected faults of an emulated bus and of the drives on it.

    Attributes:
        frame_error_probability: share of frames that are destroyed by an error frame and repeated.
        bus_off_s: time at which the drives' side goes bus-off for good; null for never.
        drives: faults of drives, in the form ``kind:node@time`` or
            ``kind:node@time+duration``, such as ``drive:2@3s``; kinds are ``drive``, ``silent``,
            ``encoder``, ``encoder-frozen`` and ``over-temperature``.
    """

    frame_error_probability: Annotated[Number, Field(ge=0, le=0.5)] = 0.0
    bus_off_s: NonNegative | None = None
    drives: tuple[str, ...] = ()


class MitConfiguration(StrictModel):
    """Drives with the MIT mini-cheetah's protocol; the defaults are those of CubeMars' AK80-9.

    Attributes:
        position_rad: largest position that a frame can hold, in both directions.
        velocity_rad_s: largest velocity.
        torque_nm: largest torque.
        stiffness_nm_rad: largest stiffness (KP_MAX).
        damping_nm_s: largest damping (KD_MAX).
        reply_identifier: CAN identifier of all replies (the master's).
        reply_bytes: 8 with temperature and error, as in newer firmware; 6 without.
    """

    position_rad: PerJointPositive = Field(default_factory=lambda: np.array([12.5]))
    velocity_rad_s: PerJointPositive = Field(default_factory=lambda: np.array([50.0]))
    torque_nm: PerJointPositive = Field(default_factory=lambda: np.array([18.0]))
    stiffness_nm_rad: PerJointPositive = Field(default_factory=lambda: np.array([500.0]))
    damping_nm_s: PerJointPositive = Field(default_factory=lambda: np.array([5.0]))
    reply_identifier: Annotated[Whole, Field(ge=0, le=0x7FF)] = 0
    reply_bytes: Literal[6, 8] = 8


DamiaoMotorName = Literal["DM4310", "DM4310_48V", "DM4340", "DM4340_48V", "DM8009"]


class DamiaoConfiguration(StrictModel):
    """Damiao motors.

    Attributes:
        motor: kind of motor of each joint, or of all: ``DM4310``, ``DM4310_48V``, ``DM4340``,
            ``DM4340_48V``, ``DM8009``. It defines the ranges of the
            values in frames, and the largest torque.
        feedback_ids: CAN identifiers of the motors' frames (MST_ID), in the order of the joints; by
            default the address + 16, as in LeRobot and OpenArm.
    """

    motor: Annotated[
        tuple[DamiaoMotorName, ...],
        BeforeValidator(lambda given: [given] if isinstance(given, str) else given),
        Field(min_length=1),
    ] = ("DM4310",)
    feedback_ids: (
        Annotated[
            tuple[Annotated[Whole, Field(ge=1, le=0x7FE)], ...], AfterValidator(_check_node_ids)
        ]
        | None
    ) = None


class CanSimpleConfiguration(StrictModel):
    """ODrive axes; master and drives must have the same values.

    Attributes:
        input_vel_scale: steps per turn/s in the velocity feed-forward.
        input_torque_scale: steps per N m in the torque feed-forward; 16 bits hold 32767.
    """

    input_vel_scale: Positive = 1000.0
    input_torque_scale: Positive = 1000.0


class CanConfiguration(StrictModel):
    """The CAN bus between controller and drives.

    Attributes:
        interface: name of the interface in python-can: ``socketcan``, ``udp_multicast`` between
            processes, ``virtual`` within one, or any hardware's.
        channel: name of the bus; by default ``vcan0``, a multicast address, or a
            name.
        port: UDP port of ``udp_multicast``. A run takes a group and a port of its own unless
            one of the two is given.
        hop_limit: reach of ``udp_multicast``: 0 is this machine; 1 its network, where anyone can
            then command the drives; more crosses routers.
        bitrate: bits per second; on emulated buses frames take time on the plant's clock.
        fd: the bus carries CAN FD frames too.
        data_bitrate: bit rate of the data phase of FD frames.
        fd_process_data: with ``cia402``, states, torques and all other process data go in FD
            frames, with ``damiao`` all frames; `fd` has to be true.
        protocol: ``cia402`` on CANopen, ODrive's ``cansimple``, the mini-cheetah's ``mit``,
            ``damiao``, the protocol of OpenArm's motors, or mjbots' ``moteus``.
        node_ids: addresses of the drives in the order of the joints; by default 1, 2, ….
        eds: description of the CiA 402 drives; by default the one that is shipped.
        encoder_bits: encoder resolution, as a power of 2 per turn of the joint.
        rated_torque_nm: unit of CiA 402's torques; by default a 32nd of the URDF's effort limits,
            which uses nearly all of 16 bits.
        heartbeat_ms: period of the heartbeats of master and drives, on the run's clock.
        heartbeat_timeout_ms: silence after which a node counts as lost.
        command_timeout_ms: time without a torque after which a drive stops by itself.
        mit: the drives of protocol ``mit``.
        damiao: the motors of protocol ``damiao``.
        cansimple: the axes of protocol ``cansimple``.
        answer_timeout_s: wall time that the master waits for the answer to a request.
        settings: keys of a protocol that a package adds, if it has any.
        faults: faults of an emulated bus and of the drives on it.
    """

    interface: str = "socketcan"
    channel: str | None = None
    port: Annotated[Whole, Field(ge=1, le=65_535)] = 43_113
    hop_limit: Annotated[Whole, Field(ge=0, le=255)] = 0
    bitrate: Literal[125_000, 250_000, 500_000, 800_000, 1_000_000] = 1_000_000
    fd: bool = False
    data_bitrate: Annotated[Whole, Field(ge=125_000, le=8_000_000)] | None = None
    fd_process_data: bool = False
    protocol: Annotated[str, BeforeValidator(str), NameIn("drive_protocols")] = "cia402"
    node_ids: Annotated[tuple[NodeId, ...], AfterValidator(_check_node_ids)] | None = None
    eds: str | None = None
    encoder_bits: Annotated[Whole, Field(ge=8, le=24)] = 20
    rated_torque_nm: PerJointPositive | None = None
    heartbeat_ms: Annotated[Whole, Field(ge=1, le=30_000)] = 20
    heartbeat_timeout_ms: Annotated[Whole, Field(ge=2, le=65_000)] = 70
    command_timeout_ms: Annotated[Whole, Field(ge=2, le=65_000)] = 50
    answer_timeout_s: Positive = 2.0
    mit: MitConfiguration = MitConfiguration()
    damiao: DamiaoConfiguration = DamiaoConfiguration()
    cansimple: CanSimpleConfiguration = CanSimpleConfiguration()
    settings: dict[str, Any] | None = None
    faults: CanFaults = CanFaults()

    @property
    def resolved_channel(self) -> str:
        """Channel name for the interface."""
        return self.channel or _CHANNELS.get(self.interface, "vcan0")

    @property
    def log_channel(self) -> str:
        """Channel name in logs, which does not depend on where the bus was."""
        return _CHANNELS.get(self.interface) or self.resolved_channel

    @property
    def counts_per_turn(self) -> int:
        return 1 << self.encoder_bits

    def node_ids_of(self, joints: int) -> tuple[int, ...]:
        """Return one address per joint.

        Raises:
            ConfigurationError: there are not as many as joints.
        """
        node_ids = self.node_ids or tuple(range(1, joints + 1))
        if len(node_ids) != joints:
            raise ConfigurationError(
                "link.can.node_ids", list(node_ids), f"one for each of the {joints} joints"
            )
        return node_ids
