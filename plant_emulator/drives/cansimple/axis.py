"""An ODrive axis: states, errors, watchdog, reports (firmware 0.6)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum, IntFlag

from bus_schema.can.cansimple.codec import TURN_RAD
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cansimple.controller import TORQUE_CONSTANT_NM_A, Controller
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    JointReading,
    Send,
)

_VELOCITY_TOLERANCE = 1.2
_BUS_VOLTAGE_V, _USUAL_TEMPERATURE_C, _HOT_C = 48.0, 25.0, 130.0
_REBOOT = 0
_MS = 1_000_000
_VERSION = {
    "Protocol_Version": 2, "Hw_Version_Major": 4, "Hw_Version_Minor": 4, "Hw_Version_Variant": 58,
    "Fw_Version_Major": 0, "Fw_Version_Minor": 6, "Fw_Version_Revision": 10,
    "Fw_Version_Unreleased": 0,
}  # fmt: skip


class AxisState(IntEnum):
    """The states this axis has."""

    IDLE = 1
    CLOSED_LOOP_CONTROL = 8


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
    """How the last request for a state ended."""

    SUCCESS = 0
    DISARMED = 3
    INVALID_STATE = 13


class Axis(Drive):
    """An axis on a joint; all at the joint, in turns and N m.

    Attributes:
        controller: what it makes of its inputs.
        state: idle or in closed-loop control.
        reports: signals of each message that the axis sends.
    """

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        self._watchdog_fed_ns = 0
        self.controller = Controller(settings)
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
            "Get_Encoder_Estimates": self._estimates,
            "Get_Iq": lambda: {
                "Iq_Setpoint": self.demand().torque_nm / TORQUE_CONSTANT_NM_A,
                "Iq_Measured": self._reading.torque_nm / TORQUE_CONSTANT_NM_A,
            },
            "Get_Temperature": lambda: {
                "FET_Temperature": _USUAL_TEMPERATURE_C,
                "Motor_Temperature": _HOT_C if self._is_hot else _USUAL_TEMPERATURE_C,
            },
            "Get_Bus_Voltage_Current": lambda: {
                "Bus_Voltage": _BUS_VOLTAGE_V, "Bus_Current": self._power_w() / _BUS_VOLTAGE_V
            },
            "Get_Torques": lambda: {
                "Torque_Target": self.demand().torque_nm, "Torque_Estimate": self._reading.torque_nm
            },
            "Get_Powers": lambda: {
                "Electrical_Power": self._power_w(), "Mechanical_Power": self._power_w()
            },
        }  # fmt: skip

    @property
    def targets(self) -> int:
        return self.controller.targets

    @property
    def fault(self) -> str | None:
        names = [error.name for error in self._errors if error.name]
        return " and ".join(names) or None

    @property
    def status(self) -> str:
        return self.state.name

    def measure(self, reading: JointReading) -> None:
        super().measure(reading)
        limit = self.controller.velocity_limit * _VELOCITY_TOLERANCE * TURN_RAD
        if self._is_armed() and abs(reading.velocity_rad_s) > limit:
            self._disarm(AxisError.VELOCITY_LIMIT_VIOLATION)

    def demand(self) -> JointDemand:
        return self.controller.demand(self._reading) if self._is_armed() else AT_REST

    def request(self, state: int) -> None:
        """Change the state, if the axis has it and has no error."""
        if state == AxisState.IDLE:
            self.state = AxisState.IDLE
            self._result = ProcedureResult.SUCCESS
        elif state != AxisState.CLOSED_LOOP_CONTROL:
            self._result = ProcedureResult.INVALID_STATE
        elif not self.controller.is_possible:
            self._disarm(AxisError.BAD_CONFIG)
        elif self._errors:
            self._result = ProcedureResult.DISARMED
        elif not self._is_armed():
            self.controller.arm(self._reading)
            self._disarm_reason = AxisError.NONE
            self.state = AxisState.CLOSED_LOOP_CONTROL
            self._result = ProcedureResult.SUCCESS

    def set_mode(self, control: int, inputs: int) -> None:
        """Choose control and input mode."""
        self.controller.choose(control, inputs)
        if self._is_armed() and not self.controller.is_possible:
            self._disarm(AxisError.BAD_CONFIG)

    def set_absolute_position(self, turns: float) -> None:
        """Define the joint's present position as this value."""
        self.controller.set_absolute_position(turns, self._reading)

    def clear_errors(self) -> None:
        """Clear errors whose causes are gone."""
        self._errors = _ERRORS[self._lasting_fault]
        self._disarm_reason = self._errors

    def reboot(self, action: int) -> None:
        """Reboot; there is no configuration to save or erase."""
        if action != _REBOOT:
            raise InvalidMessageError("out_of_range", f"this axis cannot do action {action}")
        self._start()

    def _fail(self, fault: DriveFault, now_ns: int) -> None:  # noqa: ARG002 (the interface)
        self._disarm(_ERRORS[fault])

    def advance(self, now_ns: int) -> None:
        """Disarm if the watchdog has expired."""
        timeout_ns = self._settings.watchdog_ms * _MS
        if timeout_ns and self._is_armed() and now_ns - self._watchdog_fed_ns > timeout_ns:
            self._disarm(AxisError.WATCHDOG_TIMER_EXPIRED)

    def _start(self) -> None:
        self.state = AxisState.IDLE
        self.clear_errors()
        self._result = ProcedureResult.SUCCESS
        self.controller.start()

    def _is_armed(self) -> bool:
        return self.state is AxisState.CLOSED_LOOP_CONTROL

    def _disarm(self, reason: AxisError) -> None:
        self._errors |= reason
        if self._is_armed():
            self.state = AxisState.IDLE
            self._disarm_reason = reason
        self._result = ProcedureResult.DISARMED

    def _power_w(self) -> float:
        return self._reading.torque_nm * self._reading.velocity_rad_s

    def _estimates(self) -> Mapping[str, float]:
        return {
            "Pos_Estimate": self.controller.turns(self._reading),
            "Vel_Estimate": self._reading.velocity_rad_s / TURN_RAD,
        }
