"""Registers of an emulated Damiao motor, with their permitted values.

Access and ranges are those of REGISTER_TABLE in `damiao-motor` 1.0.6, after the vendor's manuals.
Registers that nothing here acts on can be written and read back. Their defaults are ESTIMATED.
"""

from __future__ import annotations

import math
import struct

from bus_schema.can.damiao.codec import TIMEOUT_STEP_NS, DamiaoMode, DamiaoRegister
from bus_schema.can.damiao.protocol import DamiaoSettings
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.drive import DriveSettings

_INF, _MOST_IDENTIFIER, _MS = math.inf, 0x7FF, 1_000_000
_FD_RATE, _CLASSICAL_RATE = 9, 4  # CAN_BR: 5 Mbit/s, 1 Mbit/s
_IDLE = {  # register: (default, lowest, highest), of those that only can be read and written
    0: (15.0, 10.0, _INF), 1: (0.0, 0.0, _INF), 2: (100.0, 80.0, 200.0), 3: (0.9, 0.0, 1.0),
    4: (50.0, 0.0, _INF), 5: (-50.0, -_INF, 0.0), 24: (1000.0, 100.0, 10_000.0),
    28: (0.0, 0.0, _INF), 29: (60.0, 0.0, _INF), 30: (1.0, 0.0, 1.0), 31: (4.0, 1.0, 30.0),
    32: (50.0, 0.0, 500.0), 33: (1000.0, 100.0, 10_000.0), 34: (50.0, 0.0, 10_000.0),
}  # fmt: skip
_LIVE: dict[int, tuple[float, float]] = {  # those that it acts on: lowest, highest
    DamiaoRegister.MAX_SPD: (0.0, _INF), DamiaoRegister.MST_ID: (0, _MOST_IDENTIFIER),
    DamiaoRegister.ESC_ID: (0, _MOST_IDENTIFIER), DamiaoRegister.TIMEOUT: (0, 0xFFFF_FFFF),
    DamiaoRegister.CTRL_MODE: (min(DamiaoMode), max(DamiaoMode)), DamiaoRegister.PMAX: (0.0, _INF),
    DamiaoRegister.VMAX: (0.0, _INF), DamiaoRegister.TMAX: (0.0, _INF),
    DamiaoRegister.KP_ASR: (0.0, _INF), DamiaoRegister.KI_ASR: (0.0, _INF),
    DamiaoRegister.KP_APR: (0.0, _INF), DamiaoRegister.CAN_BR: (0, 9),
}  # fmt: skip
_ALLOWED = _LIVE | {register: row[1:] for register, row in _IDLE.items()}
_POSITIVE = {DamiaoRegister.PMAX, DamiaoRegister.VMAX, DamiaoRegister.TMAX, DamiaoRegister.MAX_SPD}
_FLOAT = struct.Struct("<f")


class Registers:
    """The registers of one motor.

    Args:
        settings: settings of the motor.
    """

    def __init__(self, settings: DriveSettings[DamiaoSettings]) -> None:
        own, gains = settings.own, settings.gains
        ranges = own.motor.ranges
        self._values: dict[int, float] = {register: row[0] for register, row in _IDLE.items()}
        self._values |= {
            DamiaoRegister.MAX_SPD: min(own.motor.no_load_rad_s, settings.max_velocity_rad_s),
            DamiaoRegister.MST_ID: own.feedback_id, DamiaoRegister.ESC_ID: settings.node_id,
            DamiaoRegister.CTRL_MODE: DamiaoMode.MIT,
            DamiaoRegister.TIMEOUT: settings.watchdog_ms * _MS // TIMEOUT_STEP_NS,
            DamiaoRegister.GR: own.motor.gear_ratio, DamiaoRegister.PMAX: ranges.position_rad,
            DamiaoRegister.VMAX: ranges.velocity_rad_s, DamiaoRegister.TMAX: ranges.torque_nm,
            DamiaoRegister.KP_ASR: gains.velocity_nm_s,
            DamiaoRegister.KI_ASR: gains.integral_nm_rad, DamiaoRegister.KP_APR: gains.position_1_s,
            DamiaoRegister.CAN_BR: _FD_RATE if settings.fd_process_data else _CLASSICAL_RATE,
        }  # fmt: skip

    def __getitem__(self, register: int) -> float:
        """Value of a register.

        Raises:
            InvalidMessageError: there is none.
        """
        if register not in self._values:
            raise InvalidMessageError("no_register", f"there is no register {register}")
        return self._values[register]

    def show(self, position_rad: float) -> None:
        """Update the registers that hold the shaft's position."""
        self._values[DamiaoRegister.XOUT] = position_rad
        self._values[DamiaoRegister.P_M] = position_rad * self._values[DamiaoRegister.GR]

    def write(self, register: int, value: float) -> None:
        """Set a register.

        Raises:
            InvalidMessageError: it cannot be written, or not with this value.
        """
        low, high = _ALLOWED.get(register, (_INF, -_INF))
        if not low <= value <= high or (register in _POSITIVE and value == 0.0):
            raise InvalidMessageError("no_value", f"register {register} cannot become {value}")
        self._values[register] = value
