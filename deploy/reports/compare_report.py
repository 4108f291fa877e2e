"""The report of a comparison: the counterparts of the paper's evidence, law by law."""

from __future__ import annotations

import html
from pathlib import Path

from bus_schema.recording.atomic_files import write_whole
from deploy.comparison.comparison import Comparison
from deploy.reports.compare_tables import joint_table, judge, verdict_table
from deploy.reports.figures import comparison as compare_figures
from deploy.reports.figures import settling as compare_figures_settling
from deploy.reports.figures import torque as compare_figures_torque
from deploy.reports.page import Panel, page, plot, render_sections
from deploy.reports.tables import number, tile


def write_comparison_report(comparison: Comparison, path: Path) -> None:
    """Write the report of a comparison with at least one run to an HTML file."""
    verdict = judge(comparison)
    first = comparison.runs[0]
    values = {
        "level": verdict.level,
        "headline": html.escape(verdict.headline),
        "reasons": "".join(f"<li>{html.escape(reason)}</li>" for reason in verdict.reasons),
        "tiles": _tiles(comparison),
        "from_s": f"{first.data.setup.scenario.metrics.from_s:g}",
        "verdict_table": verdict_table(comparison),
        "rms_table": joint_table(comparison, "tracking", "rms_rad", 1e3),
        "max_table": joint_table(comparison, "tracking", "max_abs_rad", 1e3),
        "settling_table": joint_table(comparison, "tracking", "settling_time_s"),
        "variation_table": joint_table(comparison, "torque", "total_variation_nm_per_s"),
        "share_table": joint_table(comparison, "torque", "share_above_50_hz", 100.0),
        "peak_table": joint_table(comparison, "torque", "peak_nm"),
        "figures": render_sections(_SECTIONS, comparison),
    }
    title = f"{first.summary['scenario']} · {verdict.headline}"
    write_whole(path, page(title, "comparison.html", values))


def _tiles(comparison: Comparison) -> str:
    scenario = comparison.runs[0].data.setup.scenario
    return "".join([
        tile("Scenario", scenario.name),
        tile("Laws", str(len(comparison.runs))),
        tile("Duration", f"{scenario.duration_s:g} s"),
        tile("Rate", number(scenario.rate_hz, 1.0, " Hz")),
        tile("Seed", str(scenario.seed), "the same for all laws, as is everything but the law"),
        tile("Nominal model", f"× {scenario.controller.model_scale:g}",
             "factor on masses and inertias of the model that model-based laws use"),
        tile("Clock", comparison.runs[0].summary["clock"]),
    ])  # fmt: skip


_SECTIONS = {
    "Precision": (
        Panel(
            "rms",
            "RMS error of every joint",
            "On a logarithmic scale: one line of the grid is a factor of ten.",
            plot(compare_figures.rms_bars),
        ),
        Panel(
            "settling",
            "Settling time",
            "When the error entered the bounds' steady state to stay. Dashed, for laws that have"
            " one: the bound on the settling time that follows from gains and inertia, whatever"
            " the start. A missing bar is a joint that never settled.",
            plot(compare_figures_settling.settling),
        ),
        Panel(
            "settling-from-afar",
            "Settling time from near and far",
            "The scenario from other starts: all joints off by as much. Dashed: the one bound that"
            " holds for every start, for laws that have one. A hollow circle left its funnel on"
            " the way; a cross at the top did not settle while it was watched.",
            plot(compare_figures_settling.settling_from_afar),
        ),
    ),
    "Joint errors": (
        Panel(
            "errors",
            "True errors inside their bounds",
            "The shaded band is the funnel, the same for all laws. The scale is that of its steady"
            " state. A click in the legend hides a law.",
            plot(compare_figures.errors_in_funnel),
        ),
        Panel(
            "errors-first-second",
            "The first second",
            "Who overshoots the far bound, and who is still outside when the bounds have closed?",
            plot(compare_figures.errors_first_second),
        ),
        Panel(
            "error-envelopes",
            "Size of the errors",
            "The largest |e| in each twentieth of a second, on a logarithmic scale: here the small"
            " ones can be told apart. Dotted: the bounds' steady state.",
            plot(compare_figures.error_envelopes),
        ),
    ),
    "End effector": (
        Panel(
            "tip-paths",
            "Path of the end effector",
            "All paths should lie on the grey reference, but for the way in from the start. Drag to"
            " turn, scroll to zoom.",
            plot(compare_figures.tip_paths),
        ),
        Panel(
            "tip-errors",
            "Cartesian errors",
            "Size of the true minus the reference position along each axis of the base frame: the"
            " largest in each twentieth of a second.",
            plot(compare_figures.tip_error_envelopes),
        ),
    ),
    "Torque": (
        Panel(
            "torques",
            "Commanded torques",
            "One column per law, one scale along each row. A thin line is smooth; a solid block of"
            " colour is chatter.",
            plot(compare_figures_torque.torques),
        ),
    ),
    "Chattering": (
        Panel(
            "total-variation",
            "Total variation of torque",
            "How far the torque travels up and down in a second, on a logarithmic scale.",
            plot(compare_figures_torque.total_variation),
        ),
        Panel(
            "chatter-share",
            "Share of torque energy above 50 Hz",
            "Of the energy of the torque without its mean, on a logarithmic scale. Nothing that the"
            " arm is asked to do is that fast.",
            plot(compare_figures_torque.chatter_share),
        ),
        Panel(
            "torque-spectra",
            "Torque by frequency",
            "Amplitude in each hertz. To the right of the dotted line it counts as chatter; the"
            " further down a line runs there, the kinder it is to gears.",
            plot(compare_figures_torque.torque_spectra),
        ),
    ),
    "What the network learned": (
        Panel(
            "network-output",
            "Network output and the dynamics it stands in for",
            "Of the first law that has a network. Coloured: its output. Grey: M q̈ + C q̇ + G of the"
            " true arm at the reference acceleration, plus friction and disturbance.",
            plot(compare_figures.network_output),
        ),
    ),
}  # fmt: skip
