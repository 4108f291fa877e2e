"""The report of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from deploy.reports.confirmation_table import confirmation_tables
from deploy.reports.figures.arm.end_effector import tip_error, tip_path
from deploy.reports.figures.arm.motion import arm_motion
from deploy.reports.figures.arm.pictures import arm_pictures
from deploy.reports.figures.errors import error_first_second, error_in_funnel, transformed_error
from deploy.reports.figures.faults import with_faults
from deploy.reports.figures.learned import (
    learned_coulomb,
    learned_inertia,
    learned_lag,
    learned_payload,
    learned_values,
    learned_viscous,
)
from deploy.reports.figures.network import network_output
from deploy.reports.figures.timeline import timeline
from deploy.reports.figures.timing import deadline_misses, timing_percentiles
from deploy.reports.figures.torque import torques
from deploy.reports.page import Fact, Panel, write_page
from deploy.reports.quantities import RMS_ERROR
from deploy.reports.run_tables import (
    event_table,
    health_table,
    joint_table,
    timing_table,
    transport_table,
)
from deploy.reports.tables import margin_text, number, percent
from deploy.reports.verdict import verdict_on_run
from deploy.runs.run_data import RunData

PANELS: list[Panel[RunData]] = [
    Panel(
        "What happened when", "timeline", "Modes of both sides", timeline,
        "A good run is ready for an instant and tracking to its end. Every way to a fault leads"
        " through stopping. Crosses are faults, triangles are limits reached for the first"
        " time; what lasts an instant is drawn wider than it was.",
        is_over_time=True,
    ),
    Panel(
        "Tracking error", "error-in-funnel", "True error inside its bounds",
        with_faults(error_in_funnel),
        "The line should stay within the shaded band. The scale is that of the steady state;"
        " the start is drawn in full beside or below. Red marks are ticks outside the bounds; a"
        " red shade, here and in all figures over time, is a scheduled fault.",
        is_over_time=True,
    ),
    Panel(
        "Tracking error", "error-first-second", "The first second", with_faults(error_first_second),
        "The bounds shrink from where the error begins. Look for overshoot beyond the far"
        " bound, and for how much room is left while the bounds close in.",
        is_over_time=True,
    ),
    Panel(
        "Control", "transformed-error", "Transformed error ε", with_faults(transformed_error),
        "Zero is perfect tracking, and ε grows without limit towards a bound: ±1 is about three"
        " quarters of the way where the bounds are symmetric. As the controller saw it.",
        is_over_time=True,
    ),
    Panel(
        "Control", "torques", "Commanded torque", with_faults(torques),
        "A smooth line is kind to gears; a solid block of colour is chatter. Dotted lines are"
        " the limits of the actuators, where the command comes near them.",
        is_over_time=True,
    ),
    Panel(
        "Motion", "tip-path", "Path of the end effector", tip_path,
        "The coloured path should lie on the grey reference, but for the way in from the start."
        " Drag to turn, scroll to zoom.",
    ),
    Panel(
        "Motion", "tip-error", "Error of the end effector", with_faults(tip_error),
        "True minus reference position in the base frame, scaled to the steady state.",
        is_over_time=True,
    ),
    Panel(
        "Motion", "arm-motion", "The arm along its run", arm_motion,
        "From joint to joint, at the instant that the bar at the foot of the page shows. Grey: on"
        " the reference. Drag to turn, scroll to zoom.",
    ),
    Panel(
        "Motion", "arm", "The arm", arm_pictures,
        "At the start, in the middle and at the end of the run, by one camera.",
        is_drawn_beside=True,
    ),
    Panel(
        "What the network learned", "network-output",
        "Network output and the dynamics it stands in for", with_faults(network_output),
        "Coloured: output of the network. Grey: M q̈ + C q̇ + G of the true arm at the reference"
        " acceleration, plus friction and disturbance. The closer the two, the less is left to"
        " the reaching terms. The scale is that of the steady state.",
        is_over_time=True,
    ),
    Panel(
        "What was learned", "learned-values", "Believed at the end, and true", learned_values,
        "What delay compensation believed of the arm, beside what the scenario gives it. Inertia"
        " factor and payload are told apart only by how differently they load the joints: where"
        " the motion hardly excites that, one stands in for the other, and only both together"
        " are right.",
    ),
    Panel(
        "What was learned", "learned-inertia", "Inertia factor 1 + α", with_faults(learned_inertia),
        "Masses and inertias over those of the nominal model. Dashed, in all these figures: the"
        " truth.",
        is_over_time=True,
    ),
    Panel(
        "What was learned", "learned-payload", "Payload", with_faults(learned_payload),
        "A point mass at the tip that the nominal model does not have.",
        is_over_time=True,
    ),
    Panel(
        "What was learned", "learned-lag", "Lag of the actuators", with_faults(learned_lag),
        "Time constant from the torque asked for to the torque delivered; at most 8 ms are"
        " believed.",
        is_over_time=True,
    ),
    Panel(
        "What was learned", "learned-coulomb", "Coulomb friction", with_faults(learned_coulomb),
        "What brakes a moving joint whatever its speed. Torques that change their sign with the"
        " velocity for other reasons are taken for it, too.",
        is_over_time=True,
    ),
    Panel(
        "What was learned", "learned-viscous", "Viscous friction", with_faults(learned_viscous),
        "What brakes a joint in proportion to its speed.",
        is_over_time=True,
    ),
    Panel(
        "Timing", "timing-percentiles", "Percentiles of times", timing_percentiles,
        "Flat to the right is good; a line that climbs at 99.9 % has rare, long delays. Control"
        " step and wake-up lateness are wall time, the others are on the run's clock. Zeros"
        " have no place on this scale and are not drawn.",
    ),
    Panel(
        "Timing", "deadline-misses", "Missed deadlines", with_faults(deadline_misses),
        "Share of the ticks at which the torque in force answered a state that was too old."
        " Single bars are disturbances of the machine or the link; a full block is a link that"
        " is slower than the deadline allows.",
        is_over_time=True,
    ),
]  # fmt: skip
"""The figures of the report, in order; another one is another entry."""


def write_report(
    run: RunData,
    summary: dict[str, Any],
    path: Path,
    conditions: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write the report of a run.

    Args:
        run: the run.
        summary: what `metrics.summarise` says of it.
        path: the HTML file to write.
        conditions: under which it came about.
    """
    verdict = verdict_on_run(run, summary, conditions)
    from_s = run.setup.scenario.metrics.from_s
    rms_errors = zip(summary["tracking"]["joint_names"], RMS_ERROR.of_joints(summary), strict=True)
    write_page(
        path,
        "run.html",
        PANELS,
        run,
        end_s=summary["duration_s"],
        title=f"{summary['scenario']} · {summary['law']} · {verdict.headline}",
        verdict=verdict,
        facts=_facts(summary),
        conditions=conditions,
        from_s=f"{from_s:g}",
        rms_facts=[Fact(joint, number(rms, unit=" mrad")) for joint, rms in rms_errors],
        joint_table=joint_table(summary, from_s),
        timing_table=timing_table(summary),
        transport_table=transport_table(summary),
        health_table=health_table(summary),
        event_table=event_table(run),
        confirmation_tables=confirmation_tables([summary]),
        digest=summary["digest"],
    )


def _facts(summary: dict[str, Any]) -> list[Fact]:
    """What was run, and the figures that matter most."""
    names = ("scenario", "law", "clock", "link")
    return [
        *(Fact(name.capitalize(), summary[name]) for name in names),
        Fact("Duration", f"{summary['duration_s']:g} s"),
        Fact("Smallest margin", margin_text(summary["bounds"]["margin_min"]),
             "1 − |e| / bound; negative outside the bounds"),
        Fact("Success rate", percent(summary["timing"]["success_rate"]),
             "share of the ticks that met their deadline"),
        Fact("Digest", summary["digest"][:12], summary["digest"]),
    ]  # fmt: skip
