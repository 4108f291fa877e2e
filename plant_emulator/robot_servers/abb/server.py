"""The controller under EGM: it sends its state to a client, whose answers correct the motion."""

from __future__ import annotations

import contextlib
import math
import select
import socket
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.egm.messages import (
    MCI_RUNNING,
    MCI_STOPPED,
    Correction,
    read_correction,
    robot_message,
)
from plant_emulator.interfaces.settings import InterfaceSettings
from plant_emulator.robot_servers.client_motion import ClientMotion
from plant_emulator.robot_servers.robot_server import RobotServer

_MOST_BYTES = 1 << 16
_AT_ONCE = 64
_STOP_RAD_S2 = 10.0
_AGAIN_S = 1.0
"""Silence of the client after which the program runs again."""
_MOST_RAD, _MOST_RAD_S = math.radians(720.0), math.radians(720.0)
"""Beyond the range and the speed of any joint of ABB's arms."""


class EgmServer(RobotServer):
    """A controller that runs ``EGMRunJoint``, and sends datagrams to port 6510 of its client."""

    ports: ClassVar[Mapping[str, int]] = {"egm": 6510}
    calls_client: ClassVar[bool] = True

    def __init__(
        self, settings: InterfaceSettings, period_s: float, say: Callable[[str], None]
    ) -> None:
        self._settings, self._period_s, self._say = settings, period_s, say
        self.interface = self._motion = ClientMotion(period_s, _STOP_RAD_S2)
        self._stops: list[dict[str, Any]] = []
        self._is_stopped = False
        self._next_s = self._now_s = 0.0
        self._heard_s = -math.inf
        self._sent = self._received = self._invalid = 0

    def open(self, host: str, ports: Mapping[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, 0))
        self._socket.setblocking(False)
        self._client = self.route((self.client_host, ports["egm"]))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0))
            probe.connect(self._client)  # raises OSError if no way leads there

    def serve(self, timeout_s: float) -> None:
        if not select.select([self._socket], [], [], max(0.0, timeout_s))[0]:
            return
        with contextlib.suppress(OSError):  # nothing more, or no client there
            for _ in range(_AT_ONCE):
                self._take(self._socket.recv(_MOST_BYTES))

    def _take(self, data: bytes) -> None:
        """Take a correction; one that cannot be used is as if it were lost."""
        joints = self._motion.planned.shape[1]
        try:
            correction = read_correction(data, joints, _MOST_RAD, _MOST_RAD_S)
        except ValueError as error:
            if not self._invalid:
                self._say(f"ignored: {error}")
            self._invalid += 1
            return
        self._received += 1
        self._heard_s = self._now_s
        if self._is_stopped:  # the client has not gone
            self._stops[-1]["is_fault"] = True
        if self._motion.is_at_rest and joints and not self._is_stopped:
            self._motion.begin(self._settings.build(self._period_s))
            self._say("corrections arrive: EGMRunJoint moves the robot")
        self._motion.put(self._target(correction))

    def _target(self, correction: Correction) -> Matrix:
        """Return the target of a correction; NaN for positions where it gives velocities."""
        position, velocity = correction
        planned = self._motion.planned[0]
        return np.stack(
            [
                np.full_like(planned, np.nan) if position is None else position,
                np.zeros_like(planned) if velocity is None else velocity,
            ]
        )

    def cycle(self, now_s: float, measured: Matrix, torque_nm: Vector) -> None:  # noqa: ARG002
        self._now_s = now_s
        self._watch()
        if now_s < self._next_s - 1e-6:
            return
        self._next_s = max(self._next_s + self._period_s, now_s)
        self._sent += 1
        mci = MCI_RUNNING if self._motion.is_moved else MCI_STOPPED
        message = robot_message(self._sent, now_s, measured, self._motion.planned, mci)
        with contextlib.suppress(OSError):  # no client there
            self._socket.sendto(message, self._client)

    def _watch(self) -> None:
        """Note a stop; once the client is silent, the program may run again."""
        motion = self._motion
        if (reflex := motion.ended_by) is not None:
            self._is_stopped, motion.ended_by = True, None
            reason = f"{reflex.kind}: {reflex.words}"
            self._stops.append({"time_s": self._now_s, "reason": reason, "is_fault": False})
            self._say(f"EGMRunJoint stopped: {reason}")
        if self._is_stopped and self._now_s - self._heard_s > _AGAIN_S and motion.is_at_rest:
            self._is_stopped = False

    def close(self) -> None:
        self._socket.close()

    @property
    def target_rad(self) -> Vector:
        return self._motion.target_rad

    @property
    def counts(self) -> dict[str, Any]:
        return {
            "sent": self._sent, "received": self._received, "invalid": self._invalid,
            "stops": self._stops,
        }  # fmt: skip
