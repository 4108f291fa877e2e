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
    "A line that climbs at the right has rare, long delays. Zeros have no place on this scale and"
    " are not drawn."
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
            "Lines should stay within the shaded band, the funnel of the first run. Red marks are"
            " ticks outside it. The scale is that of the steady state. In all figures over time a"
            " red shade is a scheduled fault.",
        ),
        _over_time(
            section, beginning, "The first second", joints.error_first_second,
            "Look for overshoot beyond the far bound, and for the room left while the bounds close"
            " in.",
        ),
        _over_time(
            section, "error-envelopes", "Size of the errors", joints.error_envelopes,
            "The largest |e| in each twentieth of a second, on a logarithmic scale: here the small"
            " ones can be told apart. Dotted: the bounds in their steady state, of the first run.",
        ),
    ]  # fmt: skip


def _tip_path(section: str, name: str) -> RunsPanel:
    return Panel(
        section, name, "Path of the end effector", space.tip_path,
        "The path should lie on the grey reference, but for the way in from the start. Drag to"
        " turn, scroll to zoom.",
    )  # fmt: skip


def _bars(section: str, name: str, of: quantities.JointQuantity, caption: str = "") -> RunsPanel:
    draw = partial(several_runs.joint_bars, quantity=of)
    return Panel(section, name, of.heading, draw, f"{caption}On a logarithmic scale.")


_NETWORK_OUTPUT = _over_time(
    "What the network learned", "network-output",
    "Network output and the dynamics it stands in for", learned.network_output,
    "Coloured: output of the network, of the first law that has one. Grey: M q̈ + C q̇ + G of the"
    " true arm at the reference acceleration, plus friction and disturbance. The closer the two,"
    " the less is left to the reaching terms.",
)  # fmt: skip

RUN_PANELS: list[RunsPanel] = [
    Panel(
        "What happened when", "timeline", "Modes of both sides", _of_run(timeline.timeline),
        "A good run is ready for an instant and tracking to its end. Crosses are faults, triangles"
        " are limits reached for the first time. What lasts an instant is drawn wider.",
        is_over_time=True,
    ),
    *_errors("Tracking error", "error-in-funnel", "error-first-second"),
    _over_time(
        "Control", "transformed-error", "Transformed error ε", _of_run(joints.transformed_error),
        "Zero is perfect tracking, and ε grows without limit towards a bound: ±1 is about three"
        " quarters of the way where the bounds are symmetric. As the controller saw it.",
    ),
    _over_time(
        "Control", "torques", "Commanded torque", _of_run(joints.torques),
        "A solid block of colour is chatter. Dotted: limits of actuators that come near them.",
    ),
    _tip_path("Motion", "tip-path"),
    _over_time(
        "Motion", "tip-error", "Error of the end effector", _of_run(space.tip_error),
        "True minus reference position in the base frame, scaled to the steady state.",
    ),
    Panel(
        "Motion", "arm-motion", "The arm along its run", _of_run(space.arm_motion),
        "From joint to joint, at the instant that the bar at the foot of the page shows. Grey: on"
        " the reference. Drag to turn, scroll to zoom.",
    ),
    Panel(
        "Motion", "arm", "The arm", _of_run(arm_pictures),
        "At the start, in the middle and at the end of the run, by one camera.",
        is_drawn_beside=True,
    ),
    _NETWORK_OUTPUT,
    Panel(
        "What was learned", "learned-values", "Believed at the end, and true",
        _of_run(learned.learned_values),
        "What delay compensation believed of the arm, beside what the scenario gives it. Where the"
        " motion hardly excites the difference between inertia factor and payload, one stands in"
        " for the other, and only both together are right.",
    ),
    *(
        _over_time("What was learned", name, title,
                   _of_run(partial(learned.learned_over_time, key=key)), caption)
        for key, name, title, caption in (
            ("inertia_factor", "learned-inertia", "Inertia factor 1 + α",
             "Masses and inertias over those of the nominal model. Grey, in all these figures:"
             " the truth."),
            ("payload_kg", "learned-payload", "Payload",
             "A point mass at the tip that the nominal model does not have."),
            ("lag_ms", "learned-lag", "Lag of the actuators",
             "Time constant from the torque asked for to the torque delivered; at most 8 ms are"
             " believed."),
            ("coulomb_nm", "learned-coulomb", "Coulomb friction",
             "What brakes a moving joint whatever its speed. Torques that change their sign with"
             " the velocity for other reasons are taken for it, too."),
            ("viscous_nm_s", "learned-viscous", "Viscous friction",
             "What brakes a joint in proportion to its speed."),
        )
    ),
    Panel(
        "Timing", "timing-percentiles", "Percentiles of times", _of_run(timeline.times_of_run),
        _PERCENTILES + " Control step and wake-up lateness are wall time, the others are on the"
        " run's clock.",
    ),
    _over_time(
        "Timing", "deadline-misses", "Missed deadlines", _of_run(timeline.deadline_misses),
        "Share of the ticks at which the torque in force answered a state that was too old. A full"
        " block is a link that is slower than the deadline allows.",
    ),
    Panel(
        "The link beside its trace", "trace-percentiles", "Delays by percentile",
        _of_run(link.trace_percentiles),
        "Solid: what the channel did to this run's messages. Dashed: the whole trace. A short run"
        " sees a part of its trace, and messages that wait for each other are delayed longer.",
    ),
    Panel(
        "The link beside its trace", "trace-autocorrelation", "Autocorrelation of the delay",
        _of_run(link.trace_autocorrelation),
        "How much the delay of a message says of the delay of a later one. Independent draws fall"
        " to zero at once; slow waves of a network do not.",
    ),
]  # fmt: skip
"""The figures of a run, in order; another one is another entry."""

_RUNS_PANELS: list[RunsPanel] = [
    _bars("Precision", "rms", quantities.RMS_ERROR),
    Panel(
        "Precision", "settling", "Settling time", several_runs.settling,
        "When the error entered the bounds' steady state to stay. A stroke across, for laws that"
        " have one: the bound on the settling time that follows from gains and inertia, whatever"
        " the start. A missing bar is a joint that never settled.",
    ),
    Panel(
        "Precision", "settling-from-afar", "Settling time from near and far",
        several_runs.settling_from_afar,
        "The scenario from other starts: all joints off by as much. Dotted: the one bound that"
        " holds for every start, for laws that have one. A hollow circle left its funnel on"
        " the way; a cross at the top did not settle while it was watched.",
    ),
    *_errors("Joint errors", "errors", "errors-first-second"),
    _over_time(
        "Joint errors", "positions-apart", "How far positions are from those of the first run",
        joints.positions_apart,
        "At the same instant, on a logarithmic scale. Where a line is missing, the runs have the"
        " same bits.",
    ),
    _tip_path("End effector", "tip-paths"),
    _over_time(
        "End effector", "tip-errors", "Cartesian errors", space.tip_error_envelopes,
        "Size of the true minus the reference position along each axis of the base frame: the"
        " largest in each twentieth of a second.",
    ),
    Panel(
        "Torque", "torques", "Commanded torques", joints.torques_side_by_side,
        "One column per run, one scale along each row. A thin line is smooth; a solid block of"
        " colour is chatter.",
    ),
    _bars("Chattering", "total-variation", quantities.TOTAL_VARIATION,
          "How far the torque travels up and down in a second. "),
    _bars("Chattering", "chatter-share", quantities.SHARE_ABOVE_50_HZ,
          "Of the energy of the torque without its mean. The arm is asked for nothing that fast. "),
    Panel(
        "Chattering", "torque-spectra", "Torque by frequency", joints.torque_spectra,
        "Amplitude in each hertz. To the right of the dotted line it counts as chatter; the"
        " further down a line runs there, the kinder it is to gears.",
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
