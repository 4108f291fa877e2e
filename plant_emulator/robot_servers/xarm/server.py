"""The controller of an xArm: commands and reports over TCP."""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.xarm import messages
from bus_schema.xarm.messages import Command, CommandReader, Detail, Function, answer
from plant_emulator.interfaces.interface import Motion, Stoppable
from plant_emulator.interfaces.response import Response
from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.interfaces.settings import InterfaceSettings
from plant_emulator.robot_servers.client_motion import ClientMotion
from plant_emulator.robot_servers.robot_server import TcpRobotServer
from plant_emulator.robot_servers.tcp_clients import Receive, TcpClients

_STOP_RAD_S2 = 20.0
_MOST_RAD = 4.0 * np.pi
"""More than any joint's range, two turns."""
_VERSION = "{axes},{axes},XI0000,AC0000,v1.12.10"
_REPORT_S: Mapping[str, float] = {"report": 0.2, "rich report": 0.2, "real-time report": 0.01}
_DETAILS = {
    "report": Detail.NORMAL, "rich report": Detail.RICH, "real-time report": Detail.SHORT,
}  # fmt: skip
_MOVES, _READY, _PAUSED, _STOPPED = 1, 2, 3, 4
_SERVO_MODE, _MOST_MODE = 1, 15


class HeldTarget(Stoppable):
    """Motion to the newest target, with the response of the joints; without one it stays.

    Args:
        response: of the joints.
    """

    def __init__(self, response: Response) -> None:
        self._response = response

    def start(self, position_rad: Vector) -> None:
        self._response.start(position_rad)
        self._target: Matrix = np.stack([position_rad, np.zeros(position_rad.size)])

    def step(self, target: Matrix | None, measured: Matrix) -> Motion:  # noqa: ARG002
        self._target = self._target if target is None else target
        return self._response.step(self._target)


class XArmServer(TcpRobotServer):
    """An xArm's controller of at most seven joints, of which servo mode moves the arm."""

    ports: ClassVar[Mapping[str, int]] = {
        "commands": 502, "report": 30001, "rich report": 30002, "real-time report": 30003,
    }  # fmt: skip
    relayed: ClassVar[str] = "commands"
    interfaces: ClassVar[tuple[str, ...]] = ("servoj",)
    joints: ClassVar[int | range | None] = range(5, messages.JOINTS + 1)

    def __init__(
        self, settings: InterfaceSettings, period_s: float, say: Callable[[str], None]
    ) -> None:
        self._settings = settings if isinstance(settings, ServoJSettings) else ServoJSettings()
        self._period_s, self._say = period_s, say
        self.interface = self._motion = ClientMotion(period_s, _STOP_RAD_S2)
        self._tcp = TcpClients(self._accept, self._left, say)
        self._reports: dict[socket.socket, str] = {}
        self._due_s = dict.fromkeys(_REPORT_S, 0.0)
        self._enabled, self._mode, self._state = False, 0, _STOPPED
        self._mover: socket.socket | None = None
        self._measured: Matrix = np.zeros((2, 0))
        self._torque_nm: Vector = np.zeros(0)
        self._now_s = 0.0
        self._stops: list[dict[str, Any]] = []
        self._count = {"targets": 0, "invalid": 0, "not_emulated": 0}

    @property
    def counts(self) -> dict[str, Any]:
        return {**self._count, "stops": self._stops}

    def cycle(self, now_s: float, measured: Matrix, torque_nm: Vector) -> None:
        self._now_s, self._measured, self._torque_nm = now_s, measured.copy(), torque_nm.copy()
        due = {name for name, due_s in self._due_s.items() if now_s >= due_s - 1e-6}
        for name in due:
            self._due_s[name] = max(self._due_s[name] + _REPORT_S[name], now_s)
        for client, name in list(self._reports.items()):
            if name in due:
                self._tcp.send(client, self._report(_DETAILS[name]))

    def _report(self, detail: Detail) -> bytes:
        return messages.report(
            self._shown_state, self._mode, _seven(self._measured[0]), _seven(self._torque_nm),
            self.description.joints, enabled=self._enabled, detail=detail,
        )  # fmt: skip

    @property
    def _shown_state(self) -> int:
        moves = self._state == _READY and (np.abs(self._motion.planned[1]) > 1e-6).any()
        return _MOVES if moves else self._state

    @property
    def _bits(self) -> int:
        """State in answers."""
        return 0 if self._enabled and self._state == _READY else messages.NOT_READY

    def _accept(self, client: socket.socket, port: str) -> Receive:
        if port != "commands":
            self._reports[client] = port
            return lambda _: None
        self._say("client connected")
        reader = CommandReader()

        def receive(data: bytes) -> None:
            for command in reader.take(data):
                if not self._tcp.send(client, self._answered(client, command)):
                    return

        return receive

    def _left(self, client: socket.socket) -> None:
        self._reports.pop(client, None)
        if client is self._mover:
            self._mover = None
            if self._motion.is_moved:
                self._stop("the client disconnected", is_fault=False)

    def _answered(self, client: socket.socket, command: Command) -> bytes:
        """Obey a command, and return its answer."""
        action = _ACTIONS.get(command.function)
        try:
            if action is not None:
                return answer(command, self._bits, action(self, command.payload))
            if command.function == Function.SERVO_JOINTS:
                self._servo(client, command.payload)
                return answer(command, self._bits)
        except (ValueError, IndexError) as error:
            if not self._count["invalid"]:
                self._say(f"ignored: {error}")
            self._count["invalid"] += 1
            return answer(command, self._bits | messages.INVALID)
        if not self._count["not_emulated"]:
            self._say(f"function {command.function} is not emulated, and refused")
        self._count["not_emulated"] += 1
        return answer(command, self._bits | messages.INVALID)

    def _servo(self, client: socket.socket, payload: bytes) -> None:
        """Follow a target; raises ValueError if it cannot be used."""
        if len(payload) != messages.SERVO_TARGET.size:
            raise ValueError(
                f"a target of {len(payload)} bytes: must have {messages.SERVO_TARGET.size}"
            )
        joints = self._motion.planned.shape[1]
        position = np.array(messages.SERVO_TARGET.unpack(payload)[:joints])
        for number, value in enumerate(position, 1):
            if not abs(value) <= _MOST_RAD:  # NaN is in no range
                raise ValueError(f"joint {number} = {value:g} rad: must be within ±{_MOST_RAD:.4g}")
        if self._bits or self._mode != _SERVO_MODE or not joints:
            return
        if not self._motion.is_moved:
            if not self._motion.is_at_rest:
                return
            self._motion.begin(HeldTarget(self._settings.response(self._period_s)))
        self._mover = client
        self._count["targets"] += 1
        self._motion.put(np.stack([position, np.zeros(joints)]))

    def _stop(self, reason: str, *, is_fault: bool) -> None:
        if self._motion.is_moved:
            self._stops.append({"time_s": self._now_s, "reason": reason, "is_fault": is_fault})
            self._say(f"stopped: {reason}")
        self._motion.end()

    def _enable(self, payload: bytes) -> bytes:
        self._enabled = bool(payload[1])
        if not self._enabled:
            self._stop("the motors were disabled by the client", is_fault=False)
        return b""

    def _set_state(self, payload: bytes) -> bytes:
        if payload[0] not in (0, _PAUSED, _STOPPED):
            raise ValueError(f"state {payload[0]}: must be 0, {_PAUSED} or {_STOPPED}")
        self._state = payload[0] or _READY
        if payload[0]:
            self._stop(f"state {payload[0]} set by the client", is_fault=False)
        return b""

    def _set_mode(self, payload: bytes) -> bytes:
        if payload[0] > _MOST_MODE:
            raise ValueError(f"mode {payload[0]}: must be from 0 to {_MOST_MODE}")
        if self._mode != payload[0]:
            self._stop(f"mode {payload[0]} set by the client", is_fault=False)
        self._mode = payload[0]
        return b""

    def _get_joints(self, payload: bytes) -> bytes:
        """Return positions; velocities and torques too if so many kinds are asked for."""
        rows = [self._measured[0], self._measured[1], self._torque_nm]
        kinds = min(max((payload or b"\1")[0] & 0x0F, 1), len(rows))
        return messages.floats([value for row in rows[:kinds] for value in _seven(row)])

    def _version(self, _: bytes) -> bytes:
        return messages.text(_VERSION.format(axes=self.description.joints))


def _seven(values: Vector) -> list[float]:
    found: list[float] = values.tolist()
    return [*found, *[0.0] * (messages.JOINTS - len(found))]


_ACTIONS: Mapping[int, Callable[[XArmServer, bytes], bytes]] = {
    Function.GET_VERSION: XArmServer._version,
    Function.GET_SERIAL_NUMBER: lambda _, __: messages.text("XI0000"),
    Function.ENABLE: XArmServer._enable,
    Function.SET_STATE: XArmServer._set_state,
    Function.GET_STATE: lambda robot, _: bytes([robot._shown_state]),
    Function.GET_COMMANDS: lambda _, __: bytes(2),
    Function.GET_ERROR: lambda _, __: bytes(2),
    Function.CLEAR_ERROR: lambda _, __: b"",
    Function.CLEAR_WARNING: lambda _, __: b"",
    Function.SET_MODE: XArmServer._set_mode,
    Function.GET_JOINTS: XArmServer._get_joints,
}
"""What commands do, and the payload of their answers."""
