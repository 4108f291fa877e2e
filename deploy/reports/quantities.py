"""The numbers that a summary has for every joint, and what tables and figures call them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from deploy.reports.tables import Column, scaled
from deploy.study.statistics import worst


@dataclass(frozen=True)
class JointQuantity:
    """A number of every joint.

    Attributes:
        heading: what it is.
        unit: in which it is shown.
        section: of ``summary.json``.
        key: in that section; its value is a list by joint, one number for all joints, or null.
        factor: from the unit of the summary to `unit`.
        brief: heading in a terminal.
        late: whether only the time from ``metrics.from_s`` on counts.
    """

    heading: str
    unit: str
    section: str
    key: str
    factor: float = 1.0
    brief: str = ""
    late: bool = False

    @property
    def column(self) -> Column:
        return Column(self.heading, self.unit, self.brief)

    def of_joints(self, summary: dict[str, Any]) -> list[float | None]:
        """Its values, shape (joints,), in `unit`; None where it is unknown."""
        given, joints = summary[self.section][self.key], len(summary["tracking"]["joint_names"])
        values = given if isinstance(given, list) else [given] * joints
        return [scaled(value, self.factor) for value in values]

    def of_worst_joint(self, summary: dict[str, Any]) -> float | None:
        """The largest of all joints; None if one of them has none."""
        return worst(self.of_joints(summary))


RMS_ERROR = JointQuantity("RMS error", "mrad", "tracking", "rms_rad", 1e3, "RMS", late=True)
LARGEST_ERROR = JointQuantity(
    "Largest error", "mrad", "tracking", "max_abs_rad", 1e3, "Largest", late=True
)
SETTLING_TIME = JointQuantity("Settling time", "s", "tracking", "settling_time_s", brief="Settled")
SETTLING_BOUND = JointQuantity("Settling bound", "s", "tracking", "settling_bound_s", brief="Bound")
RMS_TORQUE = JointQuantity("RMS torque", "N m", "torque", "rms_nm", brief="Torque\nRMS")
PEAK_TORQUE = JointQuantity("Peak torque", "N m", "torque", "peak_nm", brief="Torque\npeak")
TOTAL_VARIATION = JointQuantity(
    "Total variation of torque", "N m/s", "torque", "total_variation_nm_per_s", brief="Σ|Δτ|"
)
SHARE_ABOVE_50_HZ = JointQuantity(
    "Torque energy above 50 Hz", "%", "torque", "share_above_50_hz", 100.0, "> 50 Hz"
)

OF_ONE_RUN = (RMS_ERROR, LARGEST_ERROR, SETTLING_TIME, SETTLING_BOUND, RMS_TORQUE, PEAK_TORQUE,
              TOTAL_VARIATION)  # fmt: skip
BY_LAW = (RMS_ERROR, LARGEST_ERROR, SETTLING_TIME, TOTAL_VARIATION, SHARE_ABOVE_50_HZ, PEAK_TORQUE)

TIMES = {
    "round_trip_us": "Round trip",
    "command_age_us": "Command age",
    "state_age_us": "State age",
    "control_step_us": "Control step",
    "wakeup_lateness_us": "Wake-up lateness",
}
"""Names of the times of ``timing`` in a summary."""
SETTLED = "A joint has settled when its error has entered the bounds' steady state to stay."
