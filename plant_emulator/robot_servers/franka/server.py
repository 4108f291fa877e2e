"""The research interface: a client's commands over TCP, its targets over UDP."""

from __future__ import annotations

import contextlib
import math
import socket
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.franka import commands, states
from bus_schema.franka.commands import Command, MoveStatus, Request, RequestReader, answer
from plant_emulator.interfaces.interface import Reflex
from plant_emulator.interfaces.settings import InterfaceSettings
from plant_emulator.robot_servers.client_motion import ClientMotion
from plant_emulator.robot_servers.franka.description import described
from plant_emulator.robot_servers.franka.moves import ExternalTorque, Kind, interface_for, rows_of
from plant_emulator.robot_servers.robot_server import TcpRobotServer
from plant_emulator.robot_servers.tcp_clients import Receive, TcpClients, is_open

_STOP_RAD_S2 = 10.0
_AT_ONCE, _MOST_BYTES = 64, 1 << 12
_RATED_CYCLES = 100
"""Cycles over which the share of targets in time is taken."""


class FrankaServer(TcpRobotServer):
    """A Franka arm's controller with seven joints; one client at a time."""

    ports: ClassVar[Mapping[str, int]] = {"commands": commands.PORT}
    joints: ClassVar[int | range | None] = states.JOINTS
    arm_kind: ClassVar[str | None] = "franka_position"

    def __init__(
        self, settings: InterfaceSettings, period_s: float, say: Callable[[str], None]
    ) -> None:
        self._settings, self._period_s, self._say = settings, period_s, say
        self.interface = self._motion = ClientMotion(period_s, _STOP_RAD_S2)
        self._tcp = TcpClients(self._accept, self._left, say)
        self._client: socket.socket | None = None
        self._place: tuple[str, int] | None = None
        self._move: Request | None = None
        self._kind = Kind.POSITION
        self._torques: ExternalTorque | None = None
        self._reflex: Reflex | None = None
        self._state = states.new_state()
        self._in_time: deque[bool] = deque(maxlen=_RATED_CYCLES)
        self._has_target = False
        self._next_s = self._now_s = 0.0
        self._stops: list[dict[str, Any]] = []
        self._count = {"moves": 0, "targets": 0, "late": 0, "invalid": 0}

    def open(self, host: str, ports: Mapping[str, int]) -> None:
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind((host, 0))
        self._udp.setblocking(False)
        self._tcp.add(self._udp, self._take_datagrams)
        super().open(host, ports)

    @property
    def target_rad(self) -> Vector:
        asked_rad = self._motion.target_rad
        return asked_rad if self._kind is Kind.POSITION else np.full_like(asked_rad, np.nan)

    @property
    def counts(self) -> dict[str, Any]:
        return {**self._count, "stops": self._stops}

    def cycle(self, now_s: float, measured: Matrix, torque_nm: Vector) -> None:
        self._now_s = now_s
        if self._motion.ended_by is not None:
            self._stop_by(self._motion.ended_by)
        if now_s < self._next_s - 1e-6:
            return
        self._next_s = self._period_s * (math.floor(now_s / self._period_s + 1e-6) + 1)
        if self._motion.is_running:
            self._in_time.append(self._has_target)
        self._has_target = False
        self._publish(measured, torque_nm)

    def _publish(self, measured: Matrix, torque_nm: Vector) -> None:
        """Send the state to the client."""
        if self._place is None:
            return
        state, planned = self._state, self._motion.planned
        cycles = math.floor(self._now_s / self._period_s + 1e-6)
        state["message_id"] = round(1e3 * cycles * self._period_s)
        state["q"], state["dq"] = state["theta"], state["dtheta"] = measured
        state["q_d"], state["dq_d"] = planned
        state["tau_J"], state["tau_J_d"] = torque_nm, self._desired_nm(torque_nm)
        rate = np.mean(self._in_time) if self._in_time and self._motion.is_moved else 0.0
        state["control_command_success_rate"] = rate
        with contextlib.suppress(OSError):  # no client there
            self._udp.sendto(state.tobytes(), self._place)

    def _desired_nm(self, torque_nm: Vector) -> Vector:
        """Return the desired torque; clients take their first step from the one without gravity."""
        if not self._motion.is_moved:
            return np.zeros_like(torque_nm)
        return torque_nm if self._torques is None else self._torques.torque_nm

    def _take_datagrams(self) -> None:
        with contextlib.suppress(OSError):  # nothing more
            for _ in range(_AT_ONCE):
                self._take_target(self._udp.recv(_MOST_BYTES))

    def _take_target(self, data: bytes) -> None:
        """Take a target; one that cannot be used, or is late, is as if it were lost."""
        try:
            target = states.read_target(data)
        except ValueError as error:
            if not self._count["invalid"]:
                self._say(f"ignored: {error}")
            self._count["invalid"] += 1
            return
        if self._move is None:
            return
        self._count["targets"] += 1
        self._motion.run()
        if target["message_id"] != self._state["message_id"][0]:  # it answers an earlier state
            self._count["late"] += 1
        elif target["motion_generation_finished"] or target["torque_command_finished"]:
            self._end(MoveStatus.SUCCESS)
        else:
            self._has_target = True
            self._motion.put(rows_of(self._kind, target))

    def _accept(self, client: socket.socket, _port: str) -> Receive:
        reader = RequestReader()

        def receive(data: bytes) -> None:
            for request in reader.take(data):
                if not is_open(client):
                    return
                self._obey(client, request)

        return receive

    def _left(self, client: socket.socket) -> None:
        if client is not self._client:
            return
        if self._move is not None:
            self._note_stop("the client disconnected", is_fault=False)
        self._client = self._place = self._move = None
        self._motion.end()
        if self._reflex is None:
            self._set_idle()

    def _obey(self, client: socket.socket, request: Request) -> None:
        """Obey a command; raises ValueError to refuse the connection."""
        if request.command == Command.CONNECT:
            self._connect(client, request)
        elif client is not self._client:
            raise ValueError(f"command {request.command} of a client that is not connected")
        elif request.command == Command.MOVE:
            self._begin(request)
        elif request.command == Command.STOP_MOVE:
            if self._move is not None:
                self._end(MoveStatus.PREEMPTED)
            self._answer(request, commands.SUCCESS)
        elif request.command == Command.AUTOMATIC_ERROR_RECOVERY:
            self._recover()
            self._answer(request, commands.SUCCESS)
        elif request.command == Command.GET_ROBOT_MODEL:  # clients need an answer to connect
            self._tcp.send(client, answer(request, commands.SUCCESS, described(self.description)))
        elif (settings := commands.SETTINGS.get(request.command)) is not None:
            is_usable = all(map(math.isfinite, settings.unpack(request.payload)))
            self._answer(request, commands.SUCCESS if is_usable else commands.INVALID_ARGUMENT)
        else:
            self._say(f"command {request.command} is not emulated, and refused")
            self._answer(request, commands.NOT_POSSIBLE)

    def _connect(self, client: socket.socket, request: Request) -> None:
        version, port = commands.CONNECT.unpack(request.payload)
        if self._client is not None:
            raise ValueError("another client is connected")
        rest = commands.VERSION.to_bytes(2, "little")
        if version != commands.VERSION or not port:
            self._say(f"a client of version {version}: must be {commands.VERSION}")
            self._tcp.send(client, answer(request, commands.INCOMPATIBLE, rest))
            return
        try:
            place = self.route((client.getpeername()[0], port))
        except OSError as error:
            raise ValueError("it has gone") from error
        self._client, self._place = client, place
        self._say(f"client connected, with version {version}")
        self._tcp.send(client, answer(request, commands.SUCCESS, rest))

    def _begin(self, request: Request) -> None:
        """Begin a move, if it is of joints and the robot is ready."""
        controller, generator, *_ = commands.MOVE.unpack_from(request.payload)
        is_asynchronous = any(request.payload[commands.MOVE.size :])
        kind = _KINDS.get(generator + 1)
        if controller == states.EXTERNAL_CONTROLLER:
            kind = Kind.TORQUE
        if kind is None or generator >= states.GENERATOR_NONE or is_asynchronous:
            self._say(f"moves with motion generator {generator} are not emulated")
            self._answer(request, MoveStatus.INVALID_ARGUMENT)
            return
        is_ready = self._move is None and self._reflex is None and self._motion.is_at_rest
        if not is_ready or not self._motion.planned.size:
            self._answer(request, MoveStatus.NOT_POSSIBLE)
            return
        self._move, self._kind = request, kind
        self._count["moves"] += 1
        self._in_time.clear()
        interface = interface_for(kind, self._settings, self._period_s)
        self._torques = interface if isinstance(interface, ExternalTorque) else None
        self._motion.begin(interface)
        self._set_modes(states.ROBOT_MOVES, generator + 1, controller)
        self._say(f"move of {kind} begins")
        self._answer(request, MoveStatus.STARTED)

    def _end(self, status: MoveStatus) -> None:
        """End the move as its client wants."""
        self._motion.end()
        self._set_idle()
        if self._move is not None:
            self._answer(self._move, status)
        self._move = None

    def _stop_by(self, reflex: Reflex) -> None:
        """End the move by a reflex."""
        self._reflex, self._motion.ended_by = reflex, None
        self._note_stop(f"{reflex.kind}: {reflex.words}", is_fault=True)
        self._set_idle()
        reasons = np.zeros_like(self._state["errors"])
        if reflex.kind in states.ERRORS:
            reasons[0, states.ERRORS[reflex.kind]] = 1
        self._state["errors"] = self._state["reflex_reason"] = reasons
        self._state["robot_mode"] = states.ROBOT_REFLEX
        if self._move is not None:
            self._answer(self._move, MoveStatus.REFLEX_ABORTED)
        self._move = None

    def _recover(self) -> None:
        """Clear the reflex."""
        self._reflex = None
        self._state["errors"] = 0
        if self._move is None:
            self._state["robot_mode"] = states.ROBOT_IDLE

    def _note_stop(self, reason: str, *, is_fault: bool) -> None:
        self._stops.append({"time_s": self._now_s, "reason": reason, "is_fault": is_fault})
        self._say(f"move stopped: {reason}")

    def _set_idle(self) -> None:
        self._set_modes(states.ROBOT_IDLE, states.GENERATOR_IDLE, states.CONTROLLER_OTHER)

    def _set_modes(self, robot: int, generator: int, controller: int) -> None:
        state = self._state
        state["robot_mode"], state["motion_generator_mode"] = robot, generator
        state["controller_mode"] = controller

    def _answer(self, request: Request, status: int) -> None:
        if self._client is not None:
            self._tcp.send(self._client, answer(request, status))


_KINDS = {states.JOINT_POSITION: Kind.POSITION, states.JOINT_VELOCITY: Kind.VELOCITY}
"""Kinds of moves, by mode of the motion generator; with an external controller, torques."""
