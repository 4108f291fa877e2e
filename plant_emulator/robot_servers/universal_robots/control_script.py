"""Meaning of the registers of ur-rtde's program ``rtde_control``.

Integer register 0 has a command. The program answers in its output register 0: 1, ready; 0, not
running; 2, done, until the client has cleared the command. Servo and speed commands go on until
they are stopped: the program is ready for the next one at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.rtde.packages import Value
from plant_emulator.robot_servers.universal_robots.motion import ScriptMotion

_READY, _DONE = 1, 2
_COMMAND, _FLOAT = "input_int_register_0", "input_double_register_{}"
_JOINTS = 6
BY = "by the "
"""Begin of the reason of a stop that somebody asked for."""
_STOP_RAD_S2 = 20.0
"""Deceleration of a stop for which the client gives none."""


@dataclass(frozen=True)
class _Input:
    """Input that a command reads from a register, and its range.

    Attributes:
        name: with its unit.
        least: smallest value.
        most: largest value.
        usual: what a 0 stands for.
    """

    name: str
    least: float
    most: float
    usual: float = 0.0

    def checked(self, value: float) -> float:
        """Return the value in force; raises ValueError if it is out of range, or no number."""
        found = value or self.usual
        if not self.least <= found <= self.most:  # NaN is in no range
            raise ValueError(
                f"{self.name} = {found:g}: must be within {self.least:g} to {self.most:g}"
            )
        return found


# Limits of the e-Series and of URScript's manual; accelerations as ur-rtde limits them.
_MOST_RAD = math.radians(363.0)
_TARGET = _Input("target, rad", -_MOST_RAD, _MOST_RAD)
_SPEED = _Input("speed, rad/s", -2.0 * math.pi, 2.0 * math.pi)
_ACCELERATION = _Input("acceleration, rad/s²", 0.0, 40.0)
_DECELERATION = _Input("deceleration, rad/s²", 0.0, 40.0, _STOP_RAD_S2)
_LOOKAHEAD = _Input("lookahead time, s", 0.03, 0.2, 0.1)
_GAIN = _Input("gain", 100.0, 2000.0, 300.0)
_WATCHDOG = _Input("watchdog frequency, Hz", 0.0, 500.0)


class ControlScript:
    """The uploaded program.

    Args:
        motion: what it moves.
        step_time_s: of the controller's cycles.
        say: called with a sentence when something is not understood, or stops.

    Attributes:
        is_running: whether the program runs.
        outputs: its output registers, by name.
        commands: number of commands of each number.
        stops: time and reason of each stop of the program.
    """

    def __init__(
        self, motion: ScriptMotion, step_time_s: float, say: Callable[[str], None]
    ) -> None:
        self._motion, self._say, self._step_time_s = motion, say, step_time_s
        self.is_running, self._is_at_work = False, False
        self.outputs: dict[str, Value] = {"output_int_register_0": 0}
        self._inputs: dict[str, Value] = {}
        self.commands: dict[int, int] = {}
        self.stops: list[tuple[float, str]] = []
        self.now_s = self._last_input_s = 0.0
        self._silence_s = math.inf

    def begin(self) -> None:
        """Start the program, as after its upload."""
        self.is_running, self._is_at_work, self._silence_s = True, False, math.inf
        self._inputs[_COMMAND] = 0
        self._answer(_READY)

    def end(self, reason: str) -> None:
        """Stop the program and the arm."""
        if self.is_running:
            self.is_running = False
            self.stops.append((self.now_s, reason))
            self._say(f"program stopped: {reason}")
        self._motion.brake(_STOP_RAD_S2)
        self._answer(0)

    def take(self, values: Mapping[str, Value]) -> None:
        """Take the input registers of a package, and do what they say."""
        self._inputs |= values
        if _COMMAND in values:
            self._last_input_s = self.now_s
        if not self.is_running:
            return
        command = self._inputs.get(_COMMAND, 0)
        if not command:
            self._is_at_work = False
            self._answer(_READY)
        elif not self._is_at_work:
            number = int(command)  # type: ignore[arg-type]
            self._is_at_work = number not in _CONTINUOUS
            self.commands[number] = self.commands.get(number, 0) + 1
            self._do(number)

    def cycle(self, now_s: float) -> None:
        """Let time pass: the watchdog stops a program whose client is silent."""
        self.now_s = now_s
        if self.is_running and now_s - self._last_input_s > self._silence_s:
            self.end(f"watchdog: no input for {1e3 * self._silence_s:.0f} ms")

    def _do(self, number: int) -> None:
        action = _ACTIONS.get(number)
        if action is None:
            self._say(f"command {number} is not emulated, and does nothing")
        else:
            try:
                action(self)
            except ValueError as error:
                self.end(f"command {number}: {error}")
        if self.is_running:
            self._answer(_READY if number in _CONTINUOUS else _DONE)

    def _answer(self, state: int) -> None:
        self.outputs["output_int_register_0"] = state

    def _read(self, what: _Input, number: int) -> float:
        """Return the value of a register; raises ValueError if it is out of range."""
        return what.checked(float(self._inputs.get(_FLOAT.format(number), 0.0)))  # type: ignore[arg-type]

    def _joints(self, what: _Input) -> Vector:
        return np.array([self._read(what, number) for number in range(_JOINTS)])

    def _servoj(self) -> None:
        lookahead_s, gain = self._read(_LOOKAHEAD, 9), self._read(_GAIN, 10)
        self._motion.servo(self._joints(_TARGET), lookahead_s, gain)

    def _speedj(self) -> None:
        self._motion.speed(self._joints(_SPEED), self._read(_ACCELERATION, 6))

    def _servo_stop(self) -> None:
        self._motion.brake(self._read(_DECELERATION, 0))

    def _get_steptime(self) -> None:
        self.outputs["output_double_register_0"] = self._step_time_s

    def _set_watchdog(self) -> None:
        frequency_hz = self._read(_WATCHDOG, 0)
        self._silence_s = 1.0 / frequency_hz if frequency_hz > 0.0 else math.inf

    def _stop_script(self) -> None:
        self.end(f"{BY}client")


_ACTIONS: Mapping[int, Callable[[ControlScript], None]] = {
    9: ControlScript._speedj, 11: ControlScript._servoj, 15: ControlScript._servo_stop,
    16: ControlScript._servo_stop, 26: ControlScript._get_steptime,
    34: ControlScript._servo_stop, 35: ControlScript._set_watchdog,
    255: ControlScript._stop_script,
}  # fmt: skip
"""Commands of ur-rtde 1.6, by number."""
_CONTINUOUS = (9, 11)
"""Commands that a client repeats without clearing them."""
