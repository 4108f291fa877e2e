"""The numbers of a result that tables and figures show: what they are called, and their units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from deploy.judge.bounds import Bounds
from deploy.judge.metrics import RunResult
from deploy.reports.tables import Column, Value, margin_percent, margin_text, percent, scaled
from deploy.study.statistics import worst


@dataclass(frozen=True)
class JointQuantity:
    """A number of every joint.

    Attributes:
        heading: what it is.
        unit: in which it is shown.
        given: returns it from a result: a value for each joint, one for all of them, or None.
        factor: from the unit of the result to `unit`.
        brief: heading in a terminal.
        late: whether only the time from ``metrics.from_s`` on counts.
    """

    heading: str
    unit: str
    given: Callable[[RunResult], Sequence[float | None] | float | None]
    factor: float = 1.0
    brief: str = ""
    late: bool = False

    @property
    def column(self) -> Column:
        return Column(self.heading, self.unit, self.brief)

    def of_joints(self, result: RunResult) -> list[float | None]:
        """Its values, shape (joints,), in `unit`; None where it is unknown."""
        given, joints = self.given(result), len(result.tracking.joint_names)
        values = given if isinstance(given, Sequence) else [given] * joints
        return [scaled(value, self.factor) for value in values]

    def of_worst_joint(self, result: RunResult) -> float | None:
        """The largest of all joints; None if one of them has none."""
        return worst(self.of_joints(result))


RMS_ERROR = JointQuantity("RMS error", "mrad", lambda r: r.tracking.rms_rad, 1e3, "RMS", late=True)
LARGEST_ERROR = JointQuantity(
    "Largest error", "mrad", lambda r: r.tracking.max_abs_rad, 1e3, "Largest", late=True
)
SETTLING_TIME = JointQuantity(
    "Settling time", "s", lambda r: r.tracking.settling_time_s, brief="Settled"
)
SETTLING_BOUND = JointQuantity(
    "Settling bound", "s", lambda r: r.tracking.settling_bound_s, brief="Bound"
)
RMS_TORQUE = JointQuantity("RMS torque", "N m", lambda r: r.torque.rms_nm, brief="Torque\nRMS")
PEAK_TORQUE = JointQuantity("Peak torque", "N m", lambda r: r.torque.peak_nm, brief="Torque\npeak")
TOTAL_VARIATION = JointQuantity(
    "Total variation of torque", "N m/s", lambda r: r.torque.total_variation_nm_per_s, brief="Σ|Δτ|"
)
SHARE_ABOVE_50_HZ = JointQuantity(
    "Torque energy above 50 Hz", "%", lambda r: r.torque.share_above_50_hz, 100.0, "> 50 Hz"
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
"""Names of the times of `Timing`."""
SETTLED = "A joint has settled when its error stays within the final bounds."
DEADLINES_MET = "Deadlines met"


def margin_place(bounds: Bounds) -> str:
    """At which joint and when the smallest margin was."""
    joint, at_s = bounds.margin_min_joint, bounds.margin_min_s
    return "" if at_s is None else f" ({joint} at {at_s:.3f} s)"


def other_margins(bounds: Bounds, from_s: float) -> list[str]:
    """Tell what was left of the bounds at the start, and once they have narrowed."""
    if bounds.violation_fraction != 0 or bounds.margin_steady is None:
        return []
    later = f"from {from_s:g} s on at least {margin_text(bounds.margin_steady)}"
    start = (
        ""
        if bounds.margin_start is None
        else f"{margin_text(bounds.margin_start)} at the first tick, "
    )
    return [f"Left of the bound: {start}{later}."]


def worst_lag_ms(result: RunResult) -> float | None:
    """Time by which the joint farthest behind, or ahead, is so, ms; None if all references rest."""
    known = [each for each in result.lag_ms if each is not None]
    return max(known, key=abs, default=None)


BOUND_NUMBERS: dict[str, Callable[[RunResult], Value]] = {
    "Smallest margin (%)": lambda s: margin_percent(s.bounds.margin_min),
    "Smallest margin, where": lambda s: margin_place(s.bounds).strip(" ()") or None,
    "Margin at the start (%)": lambda s: margin_percent(s.bounds.margin_start),
    "Steady margin": lambda s: margin_text(s.bounds.margin_steady),
    "Tip error, RMS (mm)": lambda s: s.tip_error_mm.rms,
    "Tip error, largest (mm)": lambda s: s.tip_error_mm.largest,
    "Lag of a joint, largest (ms)": worst_lag_ms,
    "Ticks outside (%)": lambda s: scaled(s.bounds.violation_fraction, 100.0),
    "First outside (s)": lambda s: s.bounds.first_violation_s,
}
RUN_COUNTS: dict[str, Callable[[RunResult], Value]] = {
    "Faults": lambda s: len(s.faults),
    "Reflexes of the robot": lambda s: (
        ", ".join(f"{each.kind} at {each.time_s:.3f} s" for each in s.reflexes) or None
    ),
    DEADLINES_MET: lambda s: percent(s.timing.on_time_rate),
    "Deadlines missed": lambda s: s.timing.late_ticks,
    "Longest run of misses (ticks)": lambda s: s.timing.late_longest_run,
    "Saturated ticks (%)": lambda s: scaled(s.torque.saturated_fraction, 100.0),
    "Real-time factor": lambda s: s.real_time_factor,
    "CPU time taken by a hypervisor (ms)": lambda s: s.timing.stolen_ms,
    "Longest stall of a loop (ms)": lambda s: s.timing.longest_stall_ms,
    "Messages recorded": lambda s: s.recorder.messages,
    "Messages lost by the recorder": lambda s: s.recorder.lost,
    "Commands lost": lambda s: s.transport.downlink.lost,
    "Digest": lambda s: s.digest[:12],
}
RUN_NUMBERS = BOUND_NUMBERS | RUN_COUNTS
"""Numbers of a run as a whole, by its heading in tables of one run and of several."""
OF_LAWS: list[tuple[Column, Callable[[RunResult], Value], bool]] = [
    (Column("Ticks outside", "%", "Outside"), RUN_NUMBERS["Ticks outside (%)"], False),
    (Column("Smallest margin", brief=None), lambda s: margin_text(s.bounds.margin_min),
     False),
    (Column("Steady margin", brief="Steady\nmargin"), RUN_NUMBERS["Steady margin"], False),
    (replace(RMS_ERROR.column, brief=None), RMS_ERROR.of_worst_joint, True),
    (Column("Tip error, RMS", "mm", None), RUN_NUMBERS["Tip error, RMS (mm)"], True),
    (TOTAL_VARIATION.column, TOTAL_VARIATION.of_worst_joint, True),
    (SHARE_ABOVE_50_HZ.column, SHARE_ABOVE_50_HZ.of_worst_joint, True),
    (SETTLING_TIME.column, SETTLING_TIME.of_worst_joint, True),
    (SETTLING_BOUND.column, SETTLING_BOUND.of_worst_joint, False),
    (Column("Saturated ticks", "%", None), RUN_NUMBERS["Saturated ticks (%)"], False),
]  # fmt: skip
"""Columns of what decides between laws, and whether the smallest is the best."""
