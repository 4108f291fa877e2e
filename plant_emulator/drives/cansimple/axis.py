"""An ODrive axis: states, modes, inputs, errors, reports (firmware 0.6, passthrough input modes).

Each input message sets its own values in any control mode: a position comes with a velocity and a
torque, a velocity with a torque. Values that the control mode does not use have no effect. The last
inputs stay in force until others arrive or the axis is disarmed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum, IntFlag

from bus_schema.can.cansimple.codec import PASSTHROUGH, POSITION, TORQUE, TURN_RAD, OdriveState
from bus_schema.errors import InvalidMessageError
from bus_schema.link.can_configuration import CanSimpleConfiguration
from plant_emulator.drives.cascade import CascadeGains, CascadeLoop, Integral
from plant_emulator.drives.drive import DriveFault, DriveSettings, JointReading, Loop, Send
from plant_emulator.drives.loop_drive import LoopDrive

VELOCITY_CONTROL = 2
_TORQUE_CONSTANT_NM_A = 1.0
_VELOCITY_LIMIT_TURNS_S, _VELOCITY_TOLERANCE = 10.0, 1.2
_BUS_VOLTAGE_V = 48.0
_REBOOT = 0
_VERSION = {
    "Protocol_Version": 2, "Hw_Version_Major": 4, "Hw_Version_Minor": 4, "Hw_Version_Variant": 58,
    "Fw_Version_Major": 0, "Fw_Version_Minor": 6, "Fw_Version_Revision": 10,
    "Fw_Version_Unreleased": 0,
}  # fmt: skip


class AxisError(IntFlag):
    """The errors this axis can have."""

    NONE = 0
    MISSING_ESTIMATE = 0x8
    BAD_CONFIG = 0x10
    DRV_FAULT = 0x20
    MOTOR_OVER_TEMP = 0x2000
    VELOCITY_LIMIT_VIOLATION = 0x8000
    WATCHDOG_TIMER_EXPIRED = 0x100_0000
    ESTOP_REQUESTED = 0x200_0000


_ERRORS = {
    None: AxisError.NONE,
    DriveFault.DRIVE: AxisError.DRV_FAULT,
    DriveFault.OVER_TEMPERATURE: AxisError.MOTOR_OVER_TEMP,
    DriveFault.ENCODER: AxisError.MISSING_ESTIMATE,
}


class ProcedureResult(IntEnum):
    """Result of the last request for a state."""

    SUCCESS = 0
    DISARMED = 3
    INVALID_STATE = 13


class Axis(LoopDrive[CanSimpleConfiguration]):
    """An axis on a joint; positions are turns at the joint, torques N m.

    Attributes:
        reports: signals of each message that the axis sends.
    """

    hot_c = 130
    _errors: AxisError
    _disarm_reason: AxisError
    _gains: CascadeGains

    def __init__(self, settings: DriveSettings[CanSimpleConfiguration], send: Send) -> None:
        super().__init__(settings, send)
        self._start()
        self.reports: dict[str, Callable[[], Mapping[str, float]]] = {
            "Get_Version": lambda: _VERSION,
            "Heartbeat": lambda: {
                "Axis_Error": self._errors, "Axis_State": self.state,
                "Procedure_Result": self._result, "Trajectory_Done_Flag": 0,
            },
            "Get_Error": lambda: {
                "Active_Errors": self._errors, "Disarm_Reason": self._disarm_reason
            },
            "Address": lambda: {
                "Node_ID": settings.node_id, "Serial_Number": settings.node_id, "Connection_ID": 0
            },
            "Get_Encoder_Estimates": lambda: {
                "Pos_Estimate": self._turns, "Vel_Estimate": self._reading.velocity_rad_s / TURN_RAD
            },
            "Get_Iq": lambda: {
                "Iq_Setpoint": self.demand().torque_nm / _TORQUE_CONSTANT_NM_A,
                "Iq_Measured": self._reading.torque_nm / _TORQUE_CONSTANT_NM_A,
            },
            "Get_Temperature": lambda: {
                "FET_Temperature": 25.0, "Motor_Temperature": self.temperature_c
            },
            "Get_Bus_Voltage_Current": lambda: {
                "Bus_Voltage": _BUS_VOLTAGE_V, "Bus_Current": self._power_w / _BUS_VOLTAGE_V
            },
            "Get_Torques": lambda: {
                "Torque_Target": self.demand().torque_nm, "Torque_Estimate": self._reading.torque_nm
            },
            "Get_Powers": lambda: {
                "Electrical_Power": self._power_w, "Mechanical_Power": self._power_w
            },
        }  # fmt: skip

    @property
    def state(self) -> OdriveState:
        """Idle or in closed-loop control."""
        return OdriveState.IDLE if self._loop is None else OdriveState.CLOSED_LOOP_CONTROL

    @property
    def fault(self) -> str | None:
        names = [error.name for error in self._errors if error.name]
        return " and ".join(names) or None

    @property
    def status(self) -> str:
        return self.state.name

    def measure(self, reading: JointReading) -> None:
        super().measure(reading)
        limit = self._velocity_limit * _VELOCITY_TOLERANCE * TURN_RAD
        if self._loop is not None and abs(reading.velocity_rad_s) > limit:
            self._disarm(AxisError.VELOCITY_LIMIT_VIOLATION)

    def request(self, state: int) -> None:
        """Change the state, if the axis has it and has no error."""
        if state == OdriveState.IDLE:
            self._loop, self._result = None, ProcedureResult.SUCCESS
        elif state != OdriveState.CLOSED_LOOP_CONTROL:
            self._result = ProcedureResult.INVALID_STATE
        elif not self._has_mode():
            self._disarm(AxisError.BAD_CONFIG)
        elif self._errors:
            self._result = ProcedureResult.DISARMED
        elif self._loop is None:
            self._disarm_reason, self._result = AxisError.NONE, ProcedureResult.SUCCESS
            # The joint stays where it is until there is an input.
            self._position, self._velocity, self._torque_nm = self._turns, 0.0, 0.0
            self._integral = Integral()
            self._loop = self._closed_loop()

    def set_mode(self, control: int, inputs: int) -> None:
        """Choose control and input mode."""
        self._control, self._inputs, self._integral = control, inputs, Integral()
        if self._loop is not None and not self._has_mode():
            self._disarm(AxisError.BAD_CONFIG)
        self._update()

    def set_input(
        self, torque_nm: float, turns_s: float | None = None, turns: float | None = None
    ) -> None:
        """Set a torque, or a velocity or a position with its feed-forwards; the rest stays."""
        self._torque_nm = torque_nm
        self._velocity = self._velocity if turns_s is None else turns_s
        self._position = self._position if turns is None else turns
        self.targets += 1
        self._update()

    def set_position_gain(self, gain: float) -> None:
        """Set turns per second and turn."""
        _check(gain)
        self._gains = self._gains._replace(position_1_s=gain)
        self._update()

    def set_velocity_gains(self, gain: float, integral: float) -> None:
        """Set N m per turn per second, and the growth of the integral per second, N m per turn."""
        _check(gain, integral)
        self._gains = CascadeGains(self._gains.position_1_s, gain / TURN_RAD, integral / TURN_RAD)
        self._update()

    def set_limits(self, velocity_turns_s: float, current_a: float) -> None:
        """Set the highest speed and the largest current."""
        _check(velocity_turns_s, current_a)
        self._velocity_limit = velocity_turns_s
        self._most_nm = min(current_a * _TORQUE_CONSTANT_NM_A, self._settings.max_torque_nm)
        self._update()

    def set_absolute_position(self, turns: float) -> None:
        """Define the joint's present position as this value, and hold it."""
        self._position += turns - self._turns
        self._set_position(turns * TURN_RAD)
        self._update()

    def clear_errors(self) -> None:
        """Clear errors whose causes are gone."""
        self._errors = self._disarm_reason = _ERRORS[self._lasting_fault]

    def reboot(self, action: int) -> None:
        """Reboot; there is no configuration to save or erase."""
        if action != _REBOOT:
            raise InvalidMessageError("out_of_range", f"this axis cannot do action {action}")
        self._start()

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        self._disarm(_ERRORS[fault])

    def _time_out(self) -> None:
        self._disarm(AxisError.WATCHDOG_TIMER_EXPIRED)

    def _start(self) -> None:
        """Reset to the state after power-on."""
        settings = self._settings
        self.clear_errors()
        self._result = ProcedureResult.SUCCESS
        self._loop, self._integral, self._zero_rad = None, Integral(), 0.0
        self._control, self._inputs = POSITION.control, PASSTHROUGH
        self._position = self._velocity = self._torque_nm = 0.0
        self._gains, self._most_nm = settings.gains, settings.max_torque_nm
        self._velocity_limit = min(_VELOCITY_LIMIT_TURNS_S, settings.max_velocity_rad_s / TURN_RAD)

    def _has_mode(self) -> bool:
        """Whether this axis has the modes that were chosen."""
        controls = TORQUE.control, VELOCITY_CONTROL, POSITION.control
        return self._control in controls and self._inputs == PASSTHROUGH

    def _disarm(self, reason: AxisError) -> None:
        self._errors |= reason
        if self._loop is not None:
            self._loop, self._disarm_reason = None, reason
        self._result = ProcedureResult.DISARMED

    def _update(self) -> None:
        """Apply modes, inputs, gains and limits, if the axis is armed."""
        if self._loop is not None:
            self._loop = self._closed_loop()

    def _closed_loop(self) -> Loop:
        if self._control == TORQUE.control:
            return self._joint_loop((0.0, 0.0, 0.0, 0.0, self._torque_nm), self._most_nm)
        is_position = self._control == POSITION.control
        return CascadeLoop(
            self._position * TURN_RAD + self._zero_rad, self._velocity * TURN_RAD, self._torque_nm,
            self._gains if is_position else self._gains._replace(position_1_s=0.0), self._step_rad,
            self._velocity_limit * TURN_RAD, self._most_nm, self._integral,
        )  # fmt: skip

    @property
    def _turns(self) -> float:
        """Position of the joint, in whole increments of the encoder."""
        return round(self.position_rad / self._step_rad) / self._settings.counts_per_turn

    @property
    def _power_w(self) -> float:
        return self._reading.torque_nm * self._reading.velocity_rad_s


def _check(*values: float) -> None:
    if min(values) < 0.0:
        raise InvalidMessageError("out_of_range", "limits and gains are at least 0")
