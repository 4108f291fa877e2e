"""Protocol between law and program: records of IEEE doubles in the machine's byte order.

The program reads questions from its standard input and writes answers to its standard output. A
question is `HEADER` values and then `ROWS` rows of one value per joint; an answer is one value,
`DONE` or any other number for a failure, and then a torque per joint, N m. Each question has one
answer; the end of input is the end of the run. `funnel_hil_law.h` defines it in C.
"""

from __future__ import annotations

from enum import IntEnum

VERSION = 1
DONE = 0.0


class Question(IntEnum):
    """Kinds of questions."""

    RESET = 0
    """Forget everything; the torques of the answer are ignored."""
    TORQUE = 1
    """Return the torques for a situation."""


HEADER = ("question", "version", "joints", "time_s", "step_s", "horizon_s", "spare_1", "spare_2")
"""Names of the leading values; times as in `controller.control_law.Tracking`."""
ROWS = (
    "position_rad", "velocity_rad_s",
    "reference_position_rad", "reference_velocity_rad_s", "reference_acceleration_rad_s2",
    "upper_bound_rad", "lower_bound_rad", "torque_limit_nm",
)  # fmt: skip
"""Rows after the header. Position minus reference must stay between the bounds, of which the lower
is negative; limits are the actuators', inf for none."""
