"""The figures of reports of runs: of one run, of several laws, of recorded runs side by side."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

from deploy.judge.run_data import RunData
from deploy.reports import quantities
from deploy.reports.figures import joints, learned, link, several_runs, space, timeline
from deploy.reports.figures.arm_pictures import arm_pictures
from deploy.reports.page import Panel
from deploy.study.comparison.comparison import ComparedRuns

T = TypeVar("T")
RunsPanel = Panel[ComparedRuns]

_PERCENTILES = (
    "A line that rises at the right shows rare, long delays. Zeros cannot be drawn on this scale."
)


def _of_run(draw: Callable[[RunData], T]) -> Callable[[ComparedRuns], T]:
    """A figure of the first run, for a report of one."""
    return lambda runs: draw(runs.runs[0].data)


def _over_time(
    section: str, name: str, title: str, draw: Callable[[ComparedRuns], T], caption: str
) -> RunsPanel:
    """A panel over the time of a run, on which scheduled faults are shades."""
    return Panel(section, name, title, timeline.with_faults(draw), caption, is_over_time=True)


def _errors(section: str, whole: str, beginning: str) -> list[RunsPanel]:
    """True errors inside their bounds, with the names of two of the panels."""
    return [
        _over_time(
            section, whole, "True errors inside their bounds", joints.error_in_funnel,
            "Lines should stay within the shaded band, the funnel of the first run. Red marks"
            " are ticks outside it. The scale fits the final bounds. In all figures over time,"
            " red shades are scheduled faults.",
        ),
        _over_time(
            section, beginning, "The first second", joints.error_first_second,
            "Check for overshoot beyond the opposite bound, and for the distance to the bounds"
            " while they narrow.",
        ),
        _over_time(
            section, "error-envelopes", "Size of the errors", joints.error_envelopes,
            "The largest |e| in each twentieth of a second, on a logarithmic scale that shows"
            " small errors. Dotted: the final bounds of the first run.",
        ),
    ]  # fmt: skip


def _tip_path(section: str, name: str) -> RunsPanel:
    return Panel(
        section, name, "Path of the end effector", space.tip_path,
        "After the start, the path should lie on the grey reference. Drag to turn, scroll to"
        " zoom.",
    )  # fmt: skip


def _bars(section: str, name: str, of: quantities.JointQuantity, caption: str = "") -> RunsPanel:
    draw = partial(several_runs.joint_bars, quantity=of)
    return Panel(section, name, of.heading, draw, f"{caption}On a logarithmic scale.")


_NETWORK_OUTPUT = _over_time(
    "Learning of the network", "network-output",
    "Network output and the dynamics that it replaces", learned.network_output,
    "Coloured: output of the network, for the first law that has one. Grey: M q̈ + C q̇ + G of"
    " the true arm at the reference acceleration, plus friction and disturbance. If the two"
    " agree, the reaching terms have little left to do.",
)  # fmt: skip

RUN_PANELS: list[RunsPanel] = [
    Panel(
        "Events over time", "timeline", "Modes of controller and plant", _of_run(timeline.timeline),
        "A good run is ready for a moment, then tracking until its end. Crosses are faults,"
        " triangles are limits reached for the first time. Very short modes are drawn wider.",
        is_over_time=True,
    ),
    *_errors("Tracking error", "error-in-funnel", "error-first-second"),
    _over_time(
        "Control", "transformed-error", "Transformed error ε", _of_run(joints.transformed_error),
        "Zero is perfect tracking, and ε grows without limit towards a bound: with symmetric"
        " bounds, ±1 is about three quarters of the way. Values of the controller.",
    ),
    _over_time(
        "Control", "torques", "Commanded torque", _of_run(joints.torques),
        "A solid block of colour is chatter. Dotted: limits of the actuators, if the torque"
        " comes near them.",
    ),
    _tip_path("Motion", "tip-path"),
    _over_time(
        "Motion", "tip-error", "Error of the end effector", _of_run(space.tip_error),
        "True minus reference position in the base frame, on a scale that fits the steady state.",
    ),
    Panel(
        "Motion", "arm-motion", "The arm during the run", _of_run(space.arm_motion),
        "Lines from joint to joint, at the time that the bar at the bottom of the page shows."
        " Grey: the arm on its reference. Drag to turn, scroll to zoom.",
    ),
    Panel(
        "Motion", "arm", "The arm", _of_run(arm_pictures),
        "At the start, in the middle and at the end of the run, from the same camera.",
        is_drawn_beside=True,
    ),
    _NETWORK_OUTPUT,
    Panel(
        "What was learned", "learned-values", "Identified at the end, and true",
        _of_run(learned.learned_values),
        "Values that delay compensation identified, and those of the scenario. If the motion"
        " hardly distinguishes inertia factor and payload, one can replace the other, and only"
        " both together are correct.",
    ),
    *(
        _over_time("What was learned", name, title,
                   _of_run(partial(learned.learned_over_time, key=key)), caption)
        for key, name, title, caption in (
            ("inertia_factor", "learned-inertia", "Inertia factor 1 + α",
             "Masses and inertias, relative to the nominal model. Grey lines in these figures"
             " are the true values."),
            ("payload_kg", "learned-payload", "Payload",
             "A point mass at the tip that is not in the nominal model."),
            ("lag_ms", "learned-lag", "Lag of the actuators",
             "Time constant from commanded to delivered torque; the identification is limited"
             " to 8 ms."),
            ("coulomb_nm", "learned-coulomb", "Coulomb friction",
             "Torque against the motion that does not depend on speed. Other torques that"
             " change their sign with the velocity are included."),
            ("viscous_nm_s", "learned-viscous", "Viscous friction",
             "Torque against the motion in proportion to speed."),
        )
    ),
    Panel(
        "Timing", "timing-percentiles", "Percentiles of times", _of_run(timeline.times_of_run),
        _PERCENTILES + " Control step and wake-up lateness are wall time, the others are on the"
        " run's clock.",
    ),
    _over_time(
        "Timing", "deadline-misses", "Missed deadlines", _of_run(timeline.deadline_misses),
        "Share of the ticks at which the torque in force answered a state that was too old. A"
        " full block means that the link is slower than the deadline.",
    ),
    Panel(
        "The link compared with its trace", "trace-percentiles", "Delays by percentile",
        _of_run(link.trace_percentiles),
        "Solid: delays of this run's messages. Dashed: the whole trace. A short run uses a part"
        " of its trace, and messages that wait for each other have longer delays.",
    ),
    Panel(
        "The link compared with its trace", "trace-autocorrelation", "Autocorrelation of the delay",
        _of_run(link.trace_autocorrelation),
        "Correlation of the delays of two messages, over the time between them. Independent"
        " delays fall to zero at once; slow changes of a network do not.",
    ),
]  # fmt: skip
"""The figures of a run, in order; another one is another entry."""

_RUNS_PANELS: list[RunsPanel] = [
    _bars("Precision", "rms", quantities.RMS_ERROR),
    Panel(
        "Precision", "settling", "Settling time", several_runs.settling,
        "Time from which the error stays within the final bounds. The horizontal mark is the"
        " theoretical bound on the settling time for any start, if the law has one. A missing"
        " bar is a joint that never settled.",
    ),
    Panel(
        "Precision", "settling-from-afar", "Settling time over the initial offset",
        several_runs.settling_from_afar,
        "The scenario with other starts: the same initial offset for all joints. Dotted: the"
        " theoretical bound for every start, if the law has one. A hollow circle: the arm left"
        " its funnel. A cross at the top: the arm did not settle in the observed time.",
    ),
    *_errors("Joint errors", "errors", "errors-first-second"),
    _over_time(
        "Joint errors", "positions-apart", "Difference of positions from the first run",
        joints.positions_apart,
        "At the same time, on a logarithmic scale. Where a line is missing, the runs are"
        " bit-identical.",
    ),
    _tip_path("End effector", "tip-paths"),
    _over_time(
        "End effector", "tip-errors", "Cartesian errors", space.tip_error_envelopes,
        "Size of the true minus the reference position along each axis of the base frame: the"
        " largest in each twentieth of a second.",
    ),
    Panel(
        "Torque", "torques", "Commanded torques", joints.torques_side_by_side,
        "One column per run, one scale per row. A thin line is smooth; a solid block of colour"
        " is chatter.",
    ),
    _bars("Chattering", "total-variation", quantities.TOTAL_VARIATION,
          "Sum of all torque changes per second. "),
    _bars("Chattering", "chatter-share", quantities.SHARE_ABOVE_50_HZ,
          "Share of the energy of the torque without its mean. The reference needs no such"
          " frequencies. "),
    Panel(
        "Chattering", "torque-spectra", "Torque by frequency", joints.torque_spectra,
        "Amplitude per hertz. To the right of the dotted line it counts as chatter: a low line"
        " there means less wear of the gears.",
    ),
    _NETWORK_OUTPUT,
    *(
        Panel("Timing", key.removesuffix("_us").replace("_", "-"), title,
              partial(timeline.time_of_runs, key=key), _PERCENTILES)
        for key, title in quantities.TIMES.items()
    ),
]  # fmt: skip
_OF_RECORDINGS = {"positions-apart", *(p.id for p in _RUNS_PANELS if p.section == "Timing")}
_OF_LAWS = {"settling", "settling-from-afar", "tip-errors", "total-variation", "chatter-share",
            "network-output"}  # fmt: skip

LAW_PANELS = [panel for panel in _RUNS_PANELS if panel.id not in _OF_RECORDINGS]
"""The figures of a comparison of laws."""
RECORDED_PANELS = [panel for panel in _RUNS_PANELS if panel.id not in _OF_LAWS]
"""The figures of recorded runs side by side."""
