"""A drive's objects of CiA 402: automaton, modes, torques, position and velocity in its units."""

from __future__ import annotations

import math

from canopen.sdo.exceptions import SdoAbortedError

from bus_schema.can.cia402.codec import Cia402Settings
from plant_emulator.drives.cascade import CascadeLoop
from plant_emulator.drives.cia402.errors import ErrorCode, ErrorLog
from plant_emulator.drives.cia402.node import Abort, DriveNode
from plant_emulator.drives.cia402.position_mode import PositionMode
from plant_emulator.drives.cia402.state_machine import Automaton, ControlCommand, State, Statusword
from plant_emulator.drives.drive import AT_REST, DriveSettings, JointDemand, JointReading, following

NO_MODE, CYCLIC_SYNCHRONOUS_POSITION, CYCLIC_SYNCHRONOUS_TORQUE = 0, 8, 10
_MODES = (NO_MODE, CYCLIC_SYNCHRONOUS_POSITION, CYCLIC_SYNCHRONOUS_TORQUE)
INT16, INT32 = (-(1 << 15), (1 << 15) - 1), (-(1 << 31), (1 << 31) - 1)
_TARGET, _OFFSET, _MAX_TORQUE = 0x6071_00, 0x60B2_00, 0x6072_00
_PER_MILLE = 1000
_MILLI = 1e-3
_ALWAYS_SET = Statusword.VOLTAGE_ENABLED | Statusword.REMOTE
_ABORT_FAULT, _ABORT_DISABLE, _ABORT_QUICK_STOP = 1, 2, 3


def clamp(value: int, limits: tuple[int, int]) -> int:
    """The value, clipped to its limits."""
    lowest, highest = limits
    return lowest if value < lowest else min(value, highest)


class Motor:
    """The drive behind the dictionary: controlword and target in, torque and measured values out.

    Angles are increments of the encoder (whole numbers, to the nearest, wrapping around at 32
    bits), velocities increments per second (to the nearest, saturated at 32 bits), torques
    thousandths of the rated torque (to the nearest, saturated at 16 bits).

    Args:
        node: its dictionary.
        errors: its errors.
        settings: how it is commissioned.

    Attributes:
        automaton: its state.
    """

    def __init__(
        self, node: DriveNode, errors: ErrorLog, settings: DriveSettings[Cia402Settings]
    ) -> None:
        self._node, self._errors, self._settings = node, errors, settings
        self._rated_mnm = round(settings.own.rated_torque_nm / _MILLI)
        self._hard_limit = int(settings.max_torque_nm / (self._rated_mnm * _MILLI) * _PER_MILLE)
        self._counts_per_rad = settings.counts_per_turn / (2.0 * math.pi)
        self._reading, self._velocity = JointReading(), 0
        self._position_mode = PositionMode(node, settings)
        self._position = self._position_mode.measure(self._reading)
        self.automaton = Automaton(node, self._is_still, errors.reset)
        self._mode = NO_MODE
        self._fit()
        self._serve()

    def measure(self, reading: JointReading) -> None:
        """Set the sensor values."""
        self._reading = reading
        self._position = self._position_mode.measure(reading)
        self._velocity = clamp(round(reading.velocity_rad_s * self._counts_per_rad), INT32)

    def restore(self) -> None:
        """Restore the dictionary's defaults."""
        self._mode = self._node.values[0x6060_00]
        self._position_mode.restore()

    def fail(self, code: ErrorCode, *, power_off: bool = False) -> None:
        """Stop the drive for an error; the first error's code becomes the fault's."""
        if self.automaton.state not in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            self._errors.fault = code
        self.automaton.fault(power_off=power_off)

    def abort_connection(self, code: ErrorCode) -> None:
        """Do what object 0x6007 demands when the master is lost."""
        option = self._node.values[0x6007_00]
        if option == _ABORT_FAULT:
            self.fail(code)
        elif option == _ABORT_DISABLE:
            self.automaton.command(ControlCommand.DISABLE_VOLTAGE)
        elif option == _ABORT_QUICK_STOP:
            self.automaton.command(ControlCommand.QUICK_STOP)

    def demand(self) -> JointDemand:
        """Return torque and brake of the motor."""
        if self.automaton.brings_to_rest:
            most_nm = self._nm(clamp(self._hard_limit, INT16))
            damping_nm = -self._settings.stop_damping_nm_s * self._reading.velocity_rad_s
            return JointDemand(min(max(damping_nm, -most_nm), most_nm), is_released=True)
        if not self._follows():
            return AT_REST
        if self._mode == CYCLIC_SYNCHRONOUS_POSITION:
            return following(self._loop(), self._reading)
        return JointDemand(self._nm(self._limited()[0]), is_released=True)

    def advance(self) -> None:
        """Process due events: the end of a slow-down, the window of a following error."""
        self.automaton.advance()
        if self._mode != CYCLIC_SYNCHRONOUS_POSITION or not self.automaton.follows:
            if self._position_mode.has_followed:
                self._position_mode.rest()
            return
        self._position_mode.follow()
        if self._position_mode.error_is_fault:
            self.fail(ErrorCode.FOLLOWING_ERROR)
            self._errors.note(ErrorCode.FOLLOWING_ERROR)

    def statusword(self, _subindex: int = 0) -> int:
        """Object 0x6041."""
        word = self.automaton.state | _ALWAYS_SET
        if self._errors.any:
            word |= Statusword.WARNING
        if self._follows():
            word |= Statusword.FOLLOWS_COMMAND
            in_position_mode = self._mode == CYCLIC_SYNCHRONOUS_POSITION
            if self._is_loop_limited() if in_position_mode else self._limited()[1]:
                word |= Statusword.INTERNAL_LIMIT_ACTIVE
        if self._position_mode.has_following_error:
            word |= Statusword.FOLLOWING_ERROR
        return word

    def torque(self) -> int:
        """Object 0x6077: thousandths of the rated torque."""
        per_mille = self._reading.torque_nm / (self._rated_mnm * _MILLI) * _PER_MILLE
        return clamp(round(per_mille), INT16)

    def _follows(self) -> bool:
        return self.automaton.follows and self._mode != NO_MODE

    def _loop(self) -> CascadeLoop:
        most = min(self._node.values[_MAX_TORQUE], self._hard_limit)
        return self._position_mode.loop(self._nm(self._node.values[_OFFSET]), self._nm(most))

    def _is_loop_limited(self) -> bool:
        """Whether a limit clips the torque, while the motor closes its loop."""
        loop = self._loop()
        is_torque_limited = abs(loop.torque_nm(*self._reading[:2])) >= loop.most_nm
        return self._position_mode.is_target_limited or is_torque_limited

    def _limited(self) -> tuple[int, bool]:
        """Return the torque in per mille, and whether a limit clips it."""
        values, position, most = self._node.values, self._position, self._hard_limit
        if values[_MAX_TORQUE] < most:
            most = values[_MAX_TORQUE]
        wanted = values[_TARGET] + values[_OFFSET]
        given = wanted if -most <= wanted <= most else clamp(wanted, (-most, most))
        if (given > 0 and position >= values[0x607D_02]) or (
            given < 0 and position <= values[0x607D_01]
        ):
            given = 0
        return given, given != wanted

    def _nm(self, per_mille: int) -> float:
        return per_mille * self._rated_mnm * (_MILLI / _PER_MILLE)

    def _is_still(self) -> bool:
        return abs(self._velocity) <= self._node.values[0x606F_00]

    def _fit(self) -> None:
        """Objects whose defaults are this drive's own."""
        settings, fit = self._settings, self._node.fit
        fit(_MAX_TORQUE, clamp(self._hard_limit, (0, 0xFFFF)))
        fit(0x6076_00, self._rated_mnm)
        for place in (0x608F_01, 0x6092_01):
            fit(place, settings.counts_per_turn)

    def _serve(self) -> None:
        node = self._node
        node.readers[0x6041] = self.statusword
        node.readers[0x6061] = lambda _: self._mode
        node.readers[0x6064] = lambda _: self._position
        node.readers[0x606C] = lambda _: self._velocity
        node.readers[0x6077] = lambda _: self.torque()
        node.writers[0x6040] = lambda _, value: self.automaton.obey(value)
        node.writers[0x6060] = self._set_mode
        node.writers[0x6071] = self._count_target

    def _set_mode(self, _subindex: int, value: int) -> None:
        if value not in _MODES:
            raise SdoAbortedError(Abort.INVALID_VALUE)
        if value != self._mode:
            self._position_mode.rest()
        self._mode = value

    def _count_target(self, _subindex: int, _value: int) -> None:
        self._node.targets += self._mode != CYCLIC_SYNCHRONOUS_POSITION
