"""What a Damiao motor does to its joint: states, modes, loops, errors, timeout.

States and errors are those of the manual of the DM-J8009P-2EC, V1.0: the error of a feedback frame
is 1 in the enabled state and 0 in the disabled one, and every fault leaves the enabled state.
"""

from __future__ import annotations

import math

from bus_schema.can.damiao.codec import Mode, Special, Status, Target
from bus_schema.can.damiao.protocol import DamiaoSettings
from bus_schema.can.damiao.registers import REGISTER_IDENTIFIER, TIMEOUT_STEP_NS, Register
from bus_schema.can.mit.codec import MitCommand, MitRanges
from plant_emulator.drives.cascade import CascadeGains, CascadeLoop, Integral
from plant_emulator.drives.damiao.registers import Registers
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    JointLoop,
    Send,
)
from plant_emulator.drives.mit.drive import mit_loop

_TURN_RAD = 2.0 * math.pi
_USUAL_C, _HOT_C = 25, 110
_RESTARTING = {Register.CTRL_MODE, Register.ESC_ID, Register.MST_ID}


class DamiaoAxis(Drive):
    """The motor behind the frames.

    Attributes:
        error: a `Status`: enabled, disabled, or what is wrong.
    """

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        own = settings.own if isinstance(settings.own, DamiaoSettings) else DamiaoSettings()
        self._registers = Registers(settings, own)
        ranges = own.motor.ranges
        self._gain_ranges = ranges.stiffness_nm_rad, ranges.damping_nm_s
        self._note_registers()
        self._peak_nm = min(settings.max_torque_nm, own.motor.peak_nm)
        self._step_rad = _TURN_RAD / settings.counts_per_turn
        self._zero_rad = 0.0
        self.error = Status.DISABLED
        self._loop: JointLoop | CascadeLoop | None = None
        self._integral = Integral()
        self._heard_ns = 0

    @property
    def mode(self) -> Mode:
        """Register CTRL_MODE."""
        return Mode(int(self._registers[Register.CTRL_MODE]))

    @property
    def is_enabled(self) -> bool:
        """Whether commands count."""
        return self.error is Status.ENABLED

    @property
    def position_rad(self) -> float:
        """What its encoder shows, from its own zero."""
        seen_rad = round(self._reading.position_rad / self._step_rad) * self._step_rad
        return seen_rad - self._zero_rad

    @property
    def temperature_c(self) -> int:
        """Of power stage and coil."""
        return _HOT_C if self._is_hot else _USUAL_C

    @property
    def status(self) -> str:
        return f"{self.error.name} ({self.mode.name})"

    @property
    def fault(self) -> str | None:
        if self.error in (Status.DISABLED, Status.ENABLED):
            return None
        return f"{self.error.name} (error {self.error:#x})"

    def change(self, kind: Special) -> None:
        """Enable, disable, clear the error, or make the position zero."""
        if kind is Special.ZERO:
            self._zero_rad += self.position_rad
        elif kind is Special.ENABLE and self.error is Status.DISABLED:
            self.error = Status.ENABLED
        elif kind is Special.DISABLE and self.is_enabled:
            self._rest(Status.DISABLED)
        elif kind is Special.CLEAR_ERROR and not self.is_enabled:
            self.error = Status.COIL_HOT if self._is_hot else Status.DISABLED

    def take(self, command: MitCommand | Target) -> None:
        """Follow a command of the mode that is set; it stays in force until the next one."""
        if self.is_enabled:
            self._loop = self._loop_for(command)

    def write(self, register: int, value: float) -> None:
        """Set a register; it acts at once, and a new mode needs a new command.

        Raises:
            InvalidMessageError: it cannot be written, or not with this value.
        """
        self._registers.write(register, value)
        self._note_registers()
        if register in _RESTARTING:
            self._loop, self._integral = None, Integral()

    def _note_registers(self) -> None:
        """Keep what every frame needs of the registers."""
        values = self._registers
        limits = values[Register.PMAX], values[Register.VMAX], values[Register.TMAX]
        self._ranges = MitRanges(*limits, *self._gain_ranges)
        self._node_id = int(values[Register.ESC_ID])
        self.heard = {REGISTER_IDENTIFIER, *(self._node_id + mode.offset for mode in Mode)}
        self.on_set_up()

    def advance(self, now_ns: int) -> None:
        timeout_ns = self._registers[Register.TIMEOUT] * TIMEOUT_STEP_NS
        if timeout_ns and self._loop is not None and now_ns - self._heard_ns > timeout_ns:
            self._rest(Status.LOST_COMMUNICATION)

    def demand(self) -> JointDemand:
        loop = self._loop
        if loop is None:
            return AT_REST
        is_closed = isinstance(loop, CascadeLoop) or loop.stiffness_nm_rad or loop.damping_nm_s
        torque_nm = loop.torque_nm(*self._reading[:2])
        return JointDemand(torque_nm, is_released=True, loop=loop if is_closed else None)

    def _loop_for(self, command: MitCommand | Target) -> JointLoop | CascadeLoop:
        most_nm = min(self._peak_nm, self._registers[Register.TMAX])
        if isinstance(command, MitCommand):
            return mit_loop(command, self._zero_rad, self._step_rad, most_nm)
        values, is_velocity = self._registers, self.mode is Mode.VEL
        gains = CascadeGains(
            0.0 if is_velocity else values[Register.KP_APR],
            values[Register.KP_ASR], values[Register.KI_ASR],
        )  # fmt: skip
        fastest = values[Register.MAX_SPD]
        wanted = command.velocity_rad_s if is_velocity else 0.0
        most_rad_s = fastest if is_velocity else min(abs(command.velocity_rad_s), fastest)
        return CascadeLoop(
            command.position_rad + self._zero_rad, wanted, 0.0, gains, self._step_rad,
            most_rad_s, command.torque_share * most_nm, self._integral,
        )  # fmt: skip

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        is_hot = fault is DriveFault.OVER_TEMPERATURE
        self._rest(Status.COIL_HOT if is_hot else Status.OVER_CURRENT)

    def _rest(self, error: Status) -> None:
        self.error, self._loop, self._integral = error, None, Integral()
