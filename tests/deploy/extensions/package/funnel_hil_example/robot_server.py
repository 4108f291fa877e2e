"""A jog box's robot: a client sends lines with a velocity for each joint, over TCP."""

import select
import socket
from typing import ClassVar

import numpy as np

from plant_emulator.interfaces.interface import Motion
from plant_emulator.robot_servers.robot_server import RobotServer


class ToldJog:
    """Moves at one speed, with the signs of the newest line."""

    told = reflex = None

    def __init__(self, period_s, speed_rad_s):
        self._period_s, self._speed_rad_s = period_s, speed_rad_s

    def start(self, position_rad):
        self.position = position_rad.copy()

    def step(self, target, measured):
        rest = np.zeros_like(self.position)
        velocity = rest if self.told is None else self._speed_rad_s * np.sign(self.told)
        motion = Motion(self.position.copy(), velocity, rest)
        self.position += self._period_s * velocity
        return motion


class JogServer(RobotServer):
    """Its controller as the client sees it."""

    ports: ClassVar = {"jog": 40_059}
    relayed = "jog"

    def __init__(self, settings, period_s, say):
        self.interface = ToldJog(period_s, settings.speed_rad_s)
        self._say, self._lines, self._text = say, 0, b""

    def open(self, host, ports):
        self._sockets = [socket.create_server((host, ports["jog"]))]

    def serve(self, timeout_s):
        for ready in select.select(self._sockets, [], [], timeout_s)[0]:
            if ready is self._sockets[0]:
                self._sockets.append(ready.accept()[0])
            elif not (received := ready.recv(1024)):
                self._sockets.remove(ready)
            else:
                *lines, self._text = (self._text + received).split(b"\n")
                self._obey(lines)

    def cycle(self, now_s, measured, torque_nm):
        pass

    def close(self):
        for each in self._sockets:
            each.close()

    @property
    def target_rad(self):
        return np.full_like(self.interface.position, np.nan)

    @property
    def counts(self):
        return {"lines": self._lines}

    def _obey(self, lines):
        for line in lines:
            self.interface.told = np.array(line.split(), float)
            self._lines += 1
