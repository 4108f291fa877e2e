"""The report of a comparison: the counterparts of the paper's evidence, law by law."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from deploy.comparison.comparison import Comparison
from deploy.reports import plotly_library, quantities
from deploy.reports.confirmation_table import confirmation_tables
from deploy.reports.figures.arm.end_effector import tip_error_envelopes, tip_paths
from deploy.reports.figures.errors import error_envelopes, errors_first_second, errors_in_funnel
from deploy.reports.figures.laws import joint_bars
from deploy.reports.figures.network import first_network_output
from deploy.reports.figures.studies.settling import settling, settling_from_afar
from deploy.reports.figures.torque import torque_spectra, torques_by_law
from deploy.reports.page import Fact, Panel, write_page
from deploy.reports.studies.compare_tables import joint_table, verdict_on_laws, verdict_table
from deploy.reports.tables import number

PANELS: list[Panel[Comparison]] = [
    Panel(
        "Precision", "rms", "RMS error of every joint",
        partial(joint_bars, quantity=quantities.RMS_ERROR),
        "On a logarithmic scale.",
    ),
    Panel(
        "Precision", "settling", "Settling time", settling,
        "When the error entered the bounds' steady state to stay. A stroke across, for laws that"
        " have one: the bound on the settling time that follows from gains and inertia, whatever"
        " the start. A missing bar is a joint that never settled.",
    ),
    Panel(
        "Precision", "settling-from-afar", "Settling time from near and far", settling_from_afar,
        "The scenario from other starts: all joints off by as much. Dashed: the one bound that"
        " holds for every start, for laws that have one. A hollow circle left its funnel on"
        " the way; a cross at the top did not settle while it was watched.",
    ),
    Panel(
        "Joint errors", "errors", "True errors inside their bounds", errors_in_funnel,
        "The shaded band is the funnel, the same for all laws. The scale is that of its steady"
        " state. A click in the legend hides a law.",
        is_over_time=True,
    ),
    Panel(
        "Joint errors", "errors-first-second", "The first second", errors_first_second,
        "Who overshoots the far bound, and who is still outside when the bounds have closed?",
        is_over_time=True,
    ),
    Panel(
        "Joint errors", "error-envelopes", "Size of the errors", error_envelopes,
        "The largest |e| in each twentieth of a second, on a logarithmic scale: here the small"
        " ones can be told apart. Dotted: the bounds' steady state.",
        is_over_time=True,
    ),
    Panel(
        "End effector", "tip-paths", "Path of the end effector", tip_paths,
        "All paths should lie on the grey reference, but for the way in from the start. Drag to"
        " turn, scroll to zoom.",
    ),
    Panel(
        "End effector", "tip-errors", "Cartesian errors", tip_error_envelopes,
        "Size of the true minus the reference position along each axis of the base frame: the"
        " largest in each twentieth of a second.",
        is_over_time=True,
    ),
    Panel(
        "Torque", "torques", "Commanded torques", torques_by_law,
        "One column per law, one scale along each row. A thin line is smooth; a solid block of"
        " colour is chatter.",
    ),
    Panel(
        "Chattering", "total-variation", "Total variation of torque",
        partial(joint_bars, quantity=quantities.TOTAL_VARIATION),
        "How far the torque travels up and down in a second, on a logarithmic scale.",
    ),
    Panel(
        "Chattering", "chatter-share", "Share of torque energy above 50 Hz",
        partial(joint_bars, quantity=quantities.SHARE_ABOVE_50_HZ),
        "Of the energy of the torque without its mean, on a logarithmic scale. Nothing that the"
        " arm is asked to do is that fast.",
    ),
    Panel(
        "Chattering", "torque-spectra", "Torque by frequency", torque_spectra,
        "Amplitude in each hertz. To the right of the dotted line it counts as chatter; the"
        " further down a line runs there, the kinder it is to gears.",
    ),
    Panel(
        "What the network learned", "network-output",
        "Network output and the dynamics it stands in for", first_network_output,
        "Of the first law that has a network. Coloured: its output. Grey: M q̈ + C q̇ + G of the"
        " true arm at the reference acceleration, plus friction and disturbance.",
        is_over_time=True,
    ),
]  # fmt: skip
"""The figures of the report, in order; another one is another entry."""


def write_comparison_report(
    comparison: Comparison, path: Path, conditions: Mapping[str, str]
) -> None:
    """Write the report of a comparison with at least one run to an HTML file.

    The library of its figures goes beside it, where reports of single laws find it too.
    """
    verdict = verdict_on_laws(comparison)
    plotly_library.share(path.parent)
    write_page(
        path,
        "comparison.html",
        PANELS,
        comparison,
        end_s=max(run.summary["duration_s"] for run in comparison.runs),
        title=f"{comparison.runs[0].summary['scenario']} · {verdict.headline}",
        verdict=verdict,
        facts=_facts(comparison),
        conditions=conditions,
        verdict_table=verdict_table(comparison),
        confirmation_tables=confirmation_tables([run.summary for run in comparison.runs]),
        joint_tables=[joint_table(comparison, quantity) for quantity in quantities.BY_LAW],
    )


def _facts(comparison: Comparison) -> list[Fact]:
    scenario = comparison.runs[0].data.setup.scenario
    return [
        Fact("Scenario", scenario.name),
        Fact("Laws", str(len(comparison.runs))),
        Fact("Duration", f"{scenario.duration_s:g} s"),
        Fact("Rate", number(scenario.rate_hz, 1.0, " Hz")),
        Fact("Seed", str(scenario.seed), "the same for all laws, as is everything but the law"),
        Fact("Nominal model", f"× {scenario.controller.model_scale:g}",
             "factor on masses and inertias of the model that model-based laws use"),
        Fact("Clock", comparison.runs[0].summary["clock"]),
    ]  # fmt: skip
