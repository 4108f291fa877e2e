"""The report of a run: one HTML file that holds everything it needs and opens without a network."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from deploy.experiments import figures, figures_timing, report_tables
from deploy.experiments.arm_pictures import arm_pictures
from deploy.experiments.report_verdict import judge
from deploy.experiments.run_data import RunData


@dataclass(frozen=True)
class _Panel:
    """A figure with its title, caption and id; `content` gives its HTML, or nothing to show."""

    id: str
    title: str
    caption: str
    content: Callable[[RunData, str], str]


def write_report(run: RunData, summary: dict[str, Any], path: Path) -> None:
    """Write the report of a run.

    Args:
        run: the run.
        summary: what `metrics.summarise` says of it.
        path: the HTML file to write.
    """
    template = Template(
        resources.files("deploy.experiments").joinpath("report_template.html").read_text("utf-8")
    )
    verdict = judge(run, summary)
    page = template.substitute(
        title=html.escape(f"{summary['scenario']} · {summary['law']} · {verdict.headline}"),
        plotly_js=get_plotlyjs(),
        level=verdict.level,
        headline=html.escape(verdict.headline),
        reasons="".join(f"<li>{html.escape(reason)}</li>" for reason in verdict.reasons),
        from_s=f"{run.setup.scenario.metrics.from_s:g}",
        tiles=report_tables.banner_tiles(summary),
        rms_tiles=report_tables.rms_tiles(summary),
        joint_table=report_tables.joint_table(summary),
        timing_table=report_tables.timing_table(summary),
        transport_table=report_tables.transport_table(summary),
        health_table=report_tables.health_table(summary),
        event_table=report_tables.event_table(run),
        figures=_sections(run),
        digest=html.escape(summary["digest"]),
    )
    path.write_text(page, encoding="utf-8")


def _sections(run: RunData) -> str:
    """All sections of figures; those without a figure to show are left out."""
    sections = []
    for title, panels in _SECTIONS.items():
        shown = "".join(_figure(panel, run) for panel in panels)
        if shown:
            sections.append(f'<h2>{html.escape(title)}</h2>\n<div class="panels">{shown}</div>\n')
    return "".join(sections) or "<h2>Figures</h2><p>Nothing was recorded that could be drawn.</p>"


def _figure(panel: _Panel, run: RunData) -> str:
    content = panel.content(run, panel.id)
    if not content:
        return ""
    return (
        f'<figure class="card" id="{panel.id}"><h3>{html.escape(panel.title)}</h3>{content}'
        f"<figcaption>{html.escape(panel.caption)}</figcaption></figure>\n"
    )


def _plot(draw: Callable[[RunData], go.Figure | None]) -> Callable[[RunData, str], str]:
    def content(run: RunData, panel_id: str) -> str:
        figure = draw(run)
        if figure is None:
            return ""
        data = figure.to_json().replace("<", "\\u003c")  # nothing in it can end the script element
        return (
            f'<div id="{panel_id}-plot" style="height: {figure.layout.height}px"></div>'
            f'<script type="application/json" data-plot="{panel_id}-plot">{data}</script>'
        )

    return content


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
    "Tracking error": (
        _Panel(
            "error-in-funnel",
            "True error inside its bounds",
            "The line should stay within the shaded band. The scale is that of the steady state;"
            " the start is drawn in full beside or below. Red marks are ticks outside the bounds.",
            _plot(figures.error_in_funnel),
        ),
        _Panel(
            "error-first-second",
            "The first second",
            "The bounds shrink from where the error begins. Look for overshoot beyond the far"
            " bound, and for how much room is left while the bounds close in.",
            _plot(figures.error_first_second),
        ),
    ),
    "Control": (
        _Panel(
            "transformed-error",
            "Transformed error ε",
            "Zero is perfect tracking, and ε grows without limit towards a bound: ±1 is about three"
            " quarters of the way where the bounds are symmetric. As the controller saw it.",
            _plot(figures.transformed_error),
        ),
        _Panel(
            "torques",
            "Commanded torque",
            "A smooth line is kind to gears; a solid block of colour is chatter. Dotted lines are"
            " the limits of the actuators, where the command comes near them.",
            _plot(figures.torques),
        ),
    ),
    "Motion": (
        _Panel(
            "tip-path",
            "Path of the end effector",
            "The coloured path should lie on the grey reference, but for the way in from the start."
            " Drag to turn, scroll to zoom.",
            _plot(figures.tip_path),
        ),
        _Panel(
            "tip-error",
            "Error of the end effector",
            "True minus reference position in the base frame, scaled to the steady state.",
            _plot(figures.tip_error),
        ),
        _Panel(
            "arm",
            "The arm",
            "At the start, in the middle and at the end of the run, by one camera.",
            _pictures,
        ),
    ),
    "What the network learned": (
        _Panel(
            "network-output",
            "Network output and the dynamics it stands in for",
            "Coloured: output of the network. Grey: M q̈ + C q̇ + G of the true arm at the reference"
            " acceleration, plus friction and disturbance. The closer the two, the less is left to"
            " the reaching terms. The scale is that of the steady state.",
            _plot(figures.network_output),
        ),
    ),
    "Timing": (
        _Panel(
            "timing-percentiles",
            "Percentiles of times",
            "Flat to the right is good; a line that climbs at 99.9 % has rare, long delays. Control"
            " step and wake-up lateness are wall time, the others are on the run's clock. Zeros"
            " have no place on this scale and are not drawn.",
            _plot(figures_timing.timing_percentiles),
        ),
        _Panel(
            "deadline-misses",
            "Missed deadlines",
            "Share of the ticks at which the torque in force answered a state that was too old."
            " Single bars are disturbances of the machine or the link; a full block is a link that"
            " is slower than the deadline allows.",
            _plot(figures_timing.deadline_misses),
        ),
    ),
}  # fmt: skip
