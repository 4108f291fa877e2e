"""Base of emulated robots that answer vendors' own clients."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol

from bus_schema.arrays import Matrix, Vector
from bus_schema.registry import Registry
from bus_schema.robot_description import RobotDescription
from plant_emulator.interfaces.interface import RobotInterface
from plant_emulator.interfaces.settings import InterfaceSettings
from plant_emulator.robot_servers.tcp_clients import TcpClients

Address = tuple[str, int]


def _directly(client: Address) -> Address:
    return client


class ClientInterface(RobotInterface, Protocol):
    """An interface that a client moves."""

    @property
    def target_rad(self) -> Vector:
        """Position that the client asks for now, shape (joints,); NaN if it asks for none."""


class RobotServer(ABC):
    """A robot's controller as its clients see it.

    Args:
        settings: section of the robot's interface.
        period_s: of the controller's cycles.
        say: called with a sentence when a client comes, goes, or asks for what is not emulated.

    Attributes:
        interface: what moves the arm.
        ports: numbers of its ports, by what they are for.
        relayed: name of the port whose traffic an emulated network delays; empty if datagrams
            that the robot sends first are delayed instead.
        calls_client: whether the robot itself sends first, to a port of `ports` at its client.
        joints: number of joints that its clients expect, or a range of them; None for any.
        interfaces: interfaces that it can have, if it is named by its vendor.
        arm_kind: interface that the arm's drives are for, if clients choose it; None for the given.
        description: of the arm, which is set before its ports are opened.
        client_host: where that client is.
        route: returns where datagrams for a client are to be sent: an emulated network, or itself.
    """

    ports: ClassVar[Mapping[str, int]]
    relayed: ClassVar[str] = ""
    calls_client: ClassVar[bool] = False
    joints: ClassVar[int | range | None] = None
    interfaces: ClassVar[tuple[str, ...]] = ()
    arm_kind: ClassVar[str | None] = None
    description: RobotDescription
    client_host: str = "127.0.0.1"
    route: Callable[[Address], Address] = staticmethod(_directly)
    interface: RobotInterface

    @abstractmethod
    def __init__(
        self, settings: InterfaceSettings, period_s: float, say: Callable[[str], None]
    ) -> None: ...

    @abstractmethod
    def open(self, host: str, ports: Mapping[str, int]) -> None:
        """Listen at these ports; raises `OSError` if one is taken."""

    @abstractmethod
    def serve(self, timeout_s: float) -> None:
        """Answer clients until the time is over."""

    @abstractmethod
    def cycle(self, now_s: float, measured: Matrix, torque_nm: Vector) -> None:
        """Publish the arm's state, once per cycle.

        Args:
            now_s: time since the controller began.
            measured: positions and velocities as rows, shape (2, joints).
            torque_nm: of the actuators, shape (joints,).
        """

    @abstractmethod
    def close(self) -> None:
        """Close all connections."""

    @property
    @abstractmethod
    def target_rad(self) -> Vector:
        """Position that a client asks for now, shape (joints,); NaN if it asks for none."""

    @property
    def client_settings(self) -> dict[str, float]:
        """Settings of the interface that the client gave last, by name; empty for none."""
        return {}

    @property
    @abstractmethod
    def counts(self) -> dict[str, Any]:
        """Counts of what clients asked for, for a summary.

        ``stops``, if the robot has any, is a list of stops with ``time_s``, ``reason`` and
        ``is_fault``: whether the robot decided it while its client wanted to go on.
        """


class TcpRobotServer(RobotServer):
    """A robot with ports of TCP, whose interface has the target of its client."""

    interface: ClientInterface
    _tcp: TcpClients

    def open(self, host: str, ports: Mapping[str, int]) -> None:
        self._tcp.open(host, ports)

    def serve(self, timeout_s: float) -> None:
        self._tcp.serve(timeout_s)

    def close(self) -> None:
        self._tcp.close()

    @property
    def target_rad(self) -> Vector:
        return self.interface.target_rad


_ABB = "plant_emulator.robot_servers.abb.server:EgmServer"
_FRANKA = "plant_emulator.robot_servers.franka.server:FrankaServer"
_XARM = "plant_emulator.robot_servers.xarm.server:XArmServer"
_UNIVERSAL_ROBOTS = "plant_emulator.robot_servers.universal_robots.server:UniversalRobotsServer"
ROBOT_SERVERS: Registry[type[RobotServer]] = Registry(
    "robot_servers",
    "plant.interface.kind",
    RobotServer,
    {
        "servoj": _UNIVERSAL_ROBOTS,
        "speedj": _UNIVERSAL_ROBOTS,
        "egm": _ABB,
        "franka_position": _FRANKA,
        "franka_velocity": _FRANKA,
        "franka_torque": _FRANKA,
        "xarm": _XARM,
    },
)
"""Robots that answer vendors' clients, by the interface of the arm or, for others, by vendor."""
