"""The ports of a Universal Robots controller: RTDE, scripts and dashboard, in one thread."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.interfaces.servoj import ServoJSettings
from plant_emulator.interfaces.settings import InterfaceSettings
from plant_emulator.robot_servers.robot_server import TcpRobotServer
from plant_emulator.robot_servers.tcp_clients import Receive, TcpClients
from plant_emulator.robot_servers.universal_robots import dashboard
from plant_emulator.robot_servers.universal_robots.control_script import BY, ControlScript
from plant_emulator.robot_servers.universal_robots.motion import ScriptMotion
from plant_emulator.robot_servers.universal_robots.rtde_port import RtdeClient
from plant_emulator.robot_servers.universal_robots.variables import values_now

_PROGRAM = re.compile(rb"^def\s+(\w+)\s*\(", re.MULTILINE)
_LAST_LINE = re.compile(rb"^(end|run program)\s*$", re.MULTILINE)
_NAME = b"rtde_control"
_MOST_SCRIPT_BYTES = 1 << 20
_MOST_LINE_BYTES = 1 << 12


class UniversalRobotsServer(TcpRobotServer):
    """An e-Series controller with six joints, as ``ur-rtde`` uses it."""

    ports: ClassVar[Mapping[str, int]] = {"rtde": 30004, "script": 30003, "dashboard": 29999}
    relayed: ClassVar[str] = "rtde"
    joints: ClassVar[int | range | None] = 6

    def __init__(
        self, settings: InterfaceSettings, period_s: float, say: Callable[[str], None]
    ) -> None:
        servo = settings if isinstance(settings, ServoJSettings) else ServoJSettings()
        self.interface = self._motion = ScriptMotion(period_s, servo)
        self._script, self._say = ControlScript(self._motion, period_s, say), say
        self._tcp = TcpClients(self._receiver, self._left, say)
        self._clients: dict[socket.socket, RtdeClient] = {}
        self._unread: dict[socket.socket, bytes] = {}
        self._period_s, self._next_s = period_s, 0.0

    def cycle(self, now_s: float, measured: Matrix, torque_nm: Vector) -> None:
        if now_s < self._next_s - 1e-6:
            return
        self._next_s = max(self._next_s + self._period_s, now_s)
        self._script.cycle(now_s)
        planned = np.stack([self._motion.position, self._motion.velocity])
        values = values_now(
            now_s, measured, planned, torque_nm, runs=self._script.is_running,
            outputs=self._script.outputs,
        )  # fmt: skip
        for client in list(self._clients.values()):
            client.publish(now_s, values)

    @property
    def client_settings(self) -> dict[str, float]:
        return self._motion.servo_settings

    @property
    def counts(self) -> dict[str, Any]:
        stops = [
            {"time_s": time_s, "reason": reason, "is_fault": not reason.startswith(BY)}
            for time_s, reason in self._script.stops
        ]
        return {"commands": dict(self._script.commands), "stops": stops}

    def _receiver(self, client: socket.socket, port: str) -> Receive:
        """Greet a new connection, and return what takes its bytes."""
        self._say(f"client at the {port} port")
        if port == "rtde":
            rtde = RtdeClient(lambda data: self._tcp.send(client, data), self._script.take)
            self._clients[client] = rtde
            return rtde.receive
        self._unread[client] = b""
        if port != "dashboard":
            return lambda data: self._collect(client, data)
        self._tcp.send(client, f"{dashboard.GREETING}\n".encode())
        return lambda data: self._answer_lines(client, data)

    def _left(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        self._unread.pop(client, None)

    def _answer_lines(self, client: socket.socket, data: bytes) -> None:
        """Answer the lines that are complete."""
        *lines, rest = (self._unread[client] + data).split(b"\n")
        if len(rest) > _MOST_LINE_BYTES:
            raise ValueError(f"a line of more than {_MOST_LINE_BYTES} bytes")
        self._unread[client] = rest
        for line in lines:
            answer = dashboard.answer(line.decode("utf-8", "replace"), self._script)
            self._tcp.send(client, f"{answer}\n".encode())
            if answer == dashboard.FAREWELL:
                self._tcp.forget(client)
            if client not in self._unread:
                return

    def _collect(self, client: socket.socket, data: bytes) -> None:
        """Collect a script, and begin the program once its last line is there."""
        text = self._unread[client] + data
        if len(text) > _MOST_SCRIPT_BYTES:
            raise ValueError(f"a script of more than {_MOST_SCRIPT_BYTES} bytes")
        self._unread[client] = text
        name = _PROGRAM.search(text)
        if name is None or not _LAST_LINE.search(text, name.end()):
            return
        self._unread[client] = b""
        if name[1] == _NAME:
            self._say("program rtde_control starts")
            self._script.begin()
        else:
            self._say(f"program {name[1].decode()} is not emulated, and does nothing")
