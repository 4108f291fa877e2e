"""Damiao motors by name: what their frames can hold, and what they can do.

Ranges are those of `DM_Control_Python`, LeRobot 0.6.1 and `openarm_can` 1.4.1, which agree but for
one: the DM4340's velocity reaches to 8 rad/s in the first two and to 10 rad/s in the third. It is
register VMAX of the motor that decides. Peak torque, no-load speed and gear: Damiao's manual of the
DM-J8009P-2EC V1.0 (40 N m, 160 rpm at 24 V, 9:1); of the others, OpenArm's `joint_limits.yaml` v10
(27 N m and 52 rpm, 7 N m and 200 rpm), and the reduction that their names give.
"""

from __future__ import annotations

from typing import NamedTuple

from bus_schema.can.mit.codec import MitRanges
from bus_schema.link.can_configuration import DamiaoMotorName

_STIFFNESS_NM_RAD, _DAMPING_NM_S = 500.0, 5.0


class DamiaoMotor(NamedTuple):
    """One kind of motor, at its output shaft.

    Attributes:
        ranges: of the numbers in its frames: PMAX, VMAX, TMAX; K_p to 500 and K_d to 5 in all.
        peak_nm: the most torque it gives.
        no_load_rad_s: its speed without load.
        gear_ratio: turns of the rotor for one of the shaft.
    """

    ranges: MitRanges
    peak_nm: float
    no_load_rad_s: float
    gear_ratio: float


def _motor(
    velocity_rad_s: float, torque_nm: float, peak_nm: float, no_load_rad_s: float, gear_ratio: float
) -> DamiaoMotor:
    ranges = MitRanges(12.5, velocity_rad_s, torque_nm, _STIFFNESS_NM_RAD, _DAMPING_NM_S)
    return DamiaoMotor(ranges, peak_nm, no_load_rad_s, gear_ratio)


MOTORS: dict[DamiaoMotorName, DamiaoMotor] = {
    "DM4310": _motor(30.0, 10.0, 7.0, 20.94, 10.0),
    "DM4310_48V": _motor(50.0, 10.0, 7.0, 41.89, 10.0),
    "DM4340": _motor(8.0, 28.0, 27.0, 5.445, 40.0),
    "DM4340_48V": _motor(10.0, 28.0, 27.0, 10.89, 40.0),
    "DM8009": _motor(45.0, 54.0, 40.0, 16.75, 9.0),
}
