"""The report of a run: one HTML file that holds everything it needs and opens without a network."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from deploy.reports import tables as report_tables
from deploy.reports.figures import modes as figures_modes
from deploy.reports.figures import run as figures
from deploy.reports.figures import timing as figures_timing
from deploy.reports.figures.arm_pictures import arm_pictures
from deploy.reports.figures.faults import with_faults
from deploy.reports.page import Panel, page, plot, render_sections
from deploy.reports.verdict import judge
from deploy.runs.run_data import RunData


def write_report(run: RunData, summary: dict[str, Any], path: Path) -> None:
    """Write the report of a run.

    Args:
        run: the run.
        summary: what `metrics.summarise` says of it.
        path: the HTML file to write.
    """
    verdict = judge(run, summary)
    title = f"{summary['scenario']} · {summary['law']} · {verdict.headline}"
    values = {
        "level": verdict.level,
        "headline": html.escape(verdict.headline),
        "reasons": "".join(f"<li>{html.escape(reason)}</li>" for reason in verdict.reasons),
        "from_s": f"{run.setup.scenario.metrics.from_s:g}",
        "tiles": report_tables.banner_tiles(summary),
        "rms_tiles": report_tables.rms_tiles(summary),
        "joint_table": report_tables.joint_table(summary),
        "timing_table": report_tables.timing_table(summary),
        "transport_table": report_tables.transport_table(summary),
        "health_table": report_tables.health_table(summary),
        "event_table": report_tables.event_table(run),
        "figures": render_sections(_SECTIONS, run),
        "digest": html.escape(summary["digest"]),
    }
    write_whole(path, page(title, "run.html", values))


def _pictures(run: RunData, _: str) -> str:
    images = []
    for time_s, png in arm_pictures(run):
        source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
        label = f"{time_s:.3f} s"
        images.append(
            f'<div><img src="{source}" alt="The arm at {label}"><span>{label}</span></div>'
        )
    return f'<div class="pictures">{"".join(images)}</div>' if images else ""


_SECTIONS = {
    "What happened when": (
        Panel(
            "timeline",
            "Modes of both sides",
            "A good run is ready for an instant and tracking to its end. Every way to a fault leads"
            " through stopping. Crosses are faults, triangles are limits reached for the first"
            " time; what lasts an instant is drawn wider than it was.",
            plot(figures_modes.timeline),
        ),
    ),
    "Tracking error": (
        Panel(
            "error-in-funnel",
            "True error inside its bounds",
            "The line should stay within the shaded band. The scale is that of the steady state;"
            " the start is drawn in full beside or below. Red marks are ticks outside the bounds; a"
            " red shade, here and in all figures over time, is a scheduled fault.",
            plot(with_faults(figures.error_in_funnel)),
        ),
        Panel(
            "error-first-second",
            "The first second",
            "The bounds shrink from where the error begins. Look for overshoot beyond the far"
            " bound, and for how much room is left while the bounds close in.",
            plot(with_faults(figures.error_first_second)),
        ),
    ),
    "Control": (
        Panel(
            "transformed-error",
            "Transformed error ε",
            "Zero is perfect tracking, and ε grows without limit towards a bound: ±1 is about three"
            " quarters of the way where the bounds are symmetric. As the controller saw it.",
            plot(with_faults(figures.transformed_error)),
        ),
        Panel(
            "torques",
            "Commanded torque",
            "A smooth line is kind to gears; a solid block of colour is chatter. Dotted lines are"
            " the limits of the actuators, where the command comes near them.",
            plot(with_faults(figures.torques)),
        ),
    ),
    "Motion": (
        Panel(
            "tip-path",
            "Path of the end effector",
            "The coloured path should lie on the grey reference, but for the way in from the start."
            " Drag to turn, scroll to zoom.",
            plot(figures.tip_path),
        ),
        Panel(
            "tip-error",
            "Error of the end effector",
            "True minus reference position in the base frame, scaled to the steady state.",
            plot(with_faults(figures.tip_error)),
        ),
        Panel(
            "arm",
            "The arm",
            "At the start, in the middle and at the end of the run, by one camera.",
            _pictures,
        ),
    ),
    "What the network learned": (
        Panel(
            "network-output",
            "Network output and the dynamics it stands in for",
            "Coloured: output of the network. Grey: M q̈ + C q̇ + G of the true arm at the reference"
            " acceleration, plus friction and disturbance. The closer the two, the less is left to"
            " the reaching terms. The scale is that of the steady state.",
            plot(with_faults(figures.network_output)),
        ),
    ),
    "Timing": (
        Panel(
            "timing-percentiles",
            "Percentiles of times",
            "Flat to the right is good; a line that climbs at 99.9 % has rare, long delays. Control"
            " step and wake-up lateness are wall time, the others are on the run's clock. Zeros"
            " have no place on this scale and are not drawn.",
            plot(figures_timing.timing_percentiles),
        ),
        Panel(
            "deadline-misses",
            "Missed deadlines",
            "Share of the ticks at which the torque in force answered a state that was too old."
            " Single bars are disturbances of the machine or the link; a full block is a link that"
            " is slower than the deadline allows.",
            plot(with_faults(figures_timing.deadline_misses)),
        ),
    ),
}  # fmt: skip
