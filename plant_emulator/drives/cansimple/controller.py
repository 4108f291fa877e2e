"""An axis's controller (firmware 0.6, passthrough input modes).

Each input message sets what it has, whatever is controlled: with a position there comes a velocity
and a torque, with a velocity a torque. What the control mode has no use for, has no effect. The
last inputs stay in force until others come or the axis is disarmed.
"""

from __future__ import annotations

from bus_schema.can.cansimple.codec import TURN_RAD
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cascade import CascadeGains, CascadeLoop, Integral
from plant_emulator.drives.drive import DriveSettings, JointDemand, JointReading, following

TORQUE_CONTROL, VELOCITY_CONTROL, POSITION_CONTROL, PASSTHROUGH = 1, 2, 3, 1
TORQUE_CONSTANT_NM_A = 1.0
VELOCITY_LIMIT_TURNS_S = 10.0
_CONTROLLED = (TORQUE_CONTROL, VELOCITY_CONTROL, POSITION_CONTROL)


class Controller:
    """Mode, inputs, gains and limits of an axis; positions are turns as the axis counts them.

    Attributes:
        targets: inputs taken so far.
        velocity_limit: turns per second.
    """

    def __init__(self, settings: DriveSettings) -> None:
        self._settings = settings
        self.targets = 0
        self.start()

    def start(self) -> None:
        """Reset to the state after power-on."""
        self._control, self._inputs = POSITION_CONTROL, PASSTHROUGH
        self._gains = self._settings.gains
        self._zero_rad = 0.0
        own_limit = self._settings.max_velocity_rad_s / TURN_RAD
        self.velocity_limit = min(VELOCITY_LIMIT_TURNS_S, own_limit)
        self._current_limit = self._settings.max_torque_nm / TORQUE_CONSTANT_NM_A
        self.arm(JointReading())

    @property
    def is_possible(self) -> bool:
        """Whether this axis has the modes that were chosen."""
        return self._control in _CONTROLLED and self._inputs == PASSTHROUGH

    def choose(self, control: int, inputs: int) -> None:
        """Choose control and input mode."""
        self._control, self._inputs = control, inputs
        self._integral = Integral()

    def arm(self, reading: JointReading) -> None:
        """Closed-loop control begins: the joint stays where it is until there is an input."""
        self._position = self.turns(reading)
        self._velocity = self._torque_nm = 0.0
        self._integral = Integral()

    def take(
        self, torque_nm: float, turns_s: float | None = None, turns: float | None = None
    ) -> None:
        """Take a torque, or a velocity or a position with its feed-forwards; the rest stays."""
        self._torque_nm = torque_nm
        self._velocity = self._velocity if turns_s is None else turns_s
        self._position = self._position if turns is None else turns
        self.targets += 1

    def set_position_gain(self, gain: float) -> None:
        """Set turns per second and turn."""
        _check(gain)
        self._gains = self._gains._replace(position_1_s=gain)

    def set_velocity_gains(self, gain: float, integral: float) -> None:
        """Set N m per turn per second, and what the integral adds per second, N m per turn."""
        _check(gain, integral)
        self._gains = CascadeGains(self._gains.position_1_s, gain / TURN_RAD, integral / TURN_RAD)

    def set_limits(self, velocity_turns_s: float, current_a: float) -> None:
        """Set the highest speed and the largest current."""
        _check(velocity_turns_s, current_a)
        self.velocity_limit, self._current_limit = velocity_turns_s, current_a

    def set_absolute_position(self, turns: float, reading: JointReading) -> None:
        """Define the joint's present position as this value, and hold it."""
        moved = turns - self.turns(reading)
        self._zero_rad -= moved * TURN_RAD
        self._position += moved

    def turns(self, reading: JointReading) -> float:
        """Position of the joint, in whole increments of the encoder."""
        counts_per_turn = self._settings.counts_per_turn
        counts = round((reading.position_rad - self._zero_rad) / TURN_RAD * counts_per_turn)
        return counts / counts_per_turn

    def demand(self, reading: JointReading) -> JointDemand:
        """Return torque and loop of the armed axis."""
        current_nm = self._current_limit * TORQUE_CONSTANT_NM_A
        most_nm = min(current_nm, self._settings.max_torque_nm)
        if self._control == TORQUE_CONTROL:
            torque_nm = min(max(self._torque_nm, -most_nm), most_nm)
            return JointDemand(torque_nm, is_released=True)
        is_position = self._control == POSITION_CONTROL
        gains = self._gains if is_position else self._gains._replace(position_1_s=0.0)
        loop = CascadeLoop(
            self._position * TURN_RAD + self._zero_rad, self._velocity * TURN_RAD, self._torque_nm,
            gains, TURN_RAD / self._settings.counts_per_turn, self.velocity_limit * TURN_RAD,
            most_nm, self._integral,
        )  # fmt: skip
        return following(loop, reading)


def _check(*values: float) -> None:
    if min(values) < 0.0:
        raise InvalidMessageError("out_of_range", "limits and gains are at least 0")
