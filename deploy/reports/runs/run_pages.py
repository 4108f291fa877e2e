"""Pages of runs: of one, of several laws, of recorded runs side by side.

Each function lists the tables, facts, sentences and figures of its page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from deploy.judge.conditions import Conditions, conditions_of_recording
from deploy.judge.findings.link_delays import link_sentence, playout_sentence
from deploy.judge.metrics import RunResult
from deploy.judge.result.transport import Channel
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.runs import comparison_tables as of_runs
from deploy.reports.runs import run_numbers
from deploy.reports.runs import run_tables as of_run
from deploy.reports.runs.run_numbers import margin_place
from deploy.reports.tables import margin_text, number, percent
from deploy.reports.verdict_texts import verdict_on_laws, verdict_on_run, verdict_on_runs
from deploy.run.execute import JudgedRun
from deploy.study.comparison.comparison import ComparedRuns

if TYPE_CHECKING:
    from deploy.study.comparison.recorded import RecordedRuns


def run_page(
    run: JudgedRun, manifest: Mapping[str, Any] = MappingProxyType({})
) -> Page[ComparedRuns]:
    """Return the page of a run.

    Args:
        run: the run.
        manifest: ``manifest.json`` of its folder; empty where there is none.
    """
    result = run.result
    from_s, bounds = run.data.setup.scenario.metrics.from_s, result.bounds
    return Page(
        "report of a run",
        f"{result.scenario} · {result.law}",
        verdict_on_run(run, manifest),
        [
            Fact("Scenario", result.scenario), Fact("Law", result.law),
            Fact("Clock", result.clock), Fact("Link", result.link),
            Fact("Duration", f"{result.duration_s:g} s"),
            Fact("Smallest margin", margin_text(bounds.margin_min) + margin_place(bounds),
                 "1 − |e| / bound; negative outside the bounds"),
            Fact("Steady margin", margin_text(bounds.margin_steady),
                 f"the smallest from {from_s:g} s on, when the bounds have narrowed"),
            Fact(run_numbers.DEADLINES_MET, percent(result.timing.success_rate),
                 "share of the ticks that met their deadline"),
            Fact("Digest", result.digest[:12], result.digest),
        ],
        partial(_panels, "RUN_PANELS"),
        ComparedRuns([run]),
        conditions_of_recording(run.data, manifest),
        heading=f"{result.scenario} · {result.law} · {result.clock}",
        results=[
            Cards([of_run.joint_table(result, from_s)]),
            Cards(of_run.confirmation_tables([result.confirmation])),
        ],
        folded=(_folded_title([result]), [
            Cards([of_run.timing_table(result), of_run.health_table(result),
                   of_run.transport_table(result)], "three"),
            Cards([of_run.event_table(run.data)]),
        ]),
        lines=_run_lines(result),
        end_s=result.duration_s,
        footer="Digest of the delivered joint states and commands (SHA-256):",
        footer_code=result.digest,
    )  # fmt: skip


def _folded_title(results: Sequence[RunResult]) -> str:
    """Return the title of what is only read where something is odd in a run, and what is."""
    ways = [way for each in results for way in (each.transport.uplink, each.transport.downlink)]
    counts = {
        "deadlines missed": sum(each.timing.deadline_misses or 0 for each in results),
        "messages lost": sum(way.lost or 0 for way in ways),
        "messages rejected": sum(sum(way.rejected.values()) for way in ways),
        "faults": sum(len(each.faults) for each in results),
        "messages lost by the recorder": sum(each.recorder.lost or 0 for each in results),
    }
    odd = [f"{count:,} {what}" for what, count in counts.items() if count]
    mark = f" ⚠ {', '.join(odd)}" if odd else ""
    return f"Timing, messages and events{mark}"


def _run_lines(result: RunResult) -> list[str]:
    """Return what tables and facts of a report say, for a terminal."""
    factor, rate = result.real_time_factor, result.timing.success_rate
    counts = [
        f"{result.ticks:,} ticks",
        *([f"deadlines met {percent(rate)}"] if rate is not None else []),
        *([f"real-time factor {factor:.2f}"] if factor is not None else []),
        f"digest {result.digest[:16]}",
    ]
    lines = [*(_link_lines(result) if result.ticks else []), ", ".join(counts)]
    if skipped := result.recording.ticks_skipped:
        sent = number(result.transport.uplink.sent)
        lines.append(
            f"{skipped:,} {'tick' if skipped == 1 else 'ticks'} skipped because the plant was"
            f" late; states sent: {sent}"
        )
    return lines


def _link_lines(result: RunResult) -> list[str]:
    """Return a sentence for each direction of a link that delayed or lost messages."""
    lines = []
    for way in ("downlink", "uplink"):
        channel: Channel = getattr(result.transport, way)
        measured, emulated = channel.measured_ms, channel.delay_ms or {}
        delays_ms = emulated if measured["max"] is None else measured
        if channel.sent and (channel.lost or delays_ms.get("max")):
            link_text = link_sentence(
                channel.sent, result.duration_s, channel.lost or 0,
                (channel.loss_burst or {}).get("longest"), delays_ms, channel.reordered,
            )  # fmt: skip
            lines.append(f"{way}: {link_text}")
    playout = result.transport.playout
    if playout and playout["late"] is not None and playout["arrival_ms"]["max"] is not None:
        lines.append(playout_sentence(playout))
    return lines


def laws_page(comparison: ComparedRuns, conditions: Conditions) -> Page[ComparedRuns]:
    """Return the page of a comparison with at least one run."""
    scenario, result = comparison.runs[0].data.setup.scenario, comparison.runs[0].result
    confirmed = of_run.confirmation_tables(run.result.confirmation for run in comparison.runs)
    return Page(
        "comparison of control laws",
        result.scenario,
        verdict_on_laws(comparison),
        [
            Fact("Scenario", scenario.name),
            Fact("Laws", str(len(comparison.runs))),
            Fact("Duration", f"{scenario.duration_s:g} s"),
            Fact("Rate", number(scenario.rate_hz, 1.0, " Hz")),
            Fact("Seed", str(scenario.seed), "the same for all laws, like all other conditions"),
            Fact("Nominal model", f"× {scenario.controller.model_scale:g}",
                 "factor on masses and inertias of the nominal model"),
            Fact("Clock", result.clock),
        ],
        partial(_panels, "LAW_PANELS"),
        comparison,
        conditions,
        results=[
            Cards([of_runs.verdict_table(comparison)]), Cards(confirmed),
            Cards([of_runs.law_table(comparison, each) for each in run_numbers.BY_LAW], "three"),
        ],
        folded=(_folded_title([run.result for run in comparison.runs]), []),
        end_s=max(run.result.duration_s for run in comparison.runs),
        footer=("Each law has its own folder beside this report, with its recording. This command"
               " writes the report of that run alone:"),
        footer_code="funnel-hil report",
        shares_library=True,
    )  # fmt: skip


def diff_page(compared: RecordedRuns, conditions: Conditions) -> Page[ComparedRuns]:
    """Return the page of recorded runs side by side."""
    differences = [of_runs.difference_table(compared)] if compared.differing else []
    return Page(
        "recorded runs side by side",
        " · ".join(compared.labels),
        verdict_on_runs(compared),
        [Fact(label, str(place))
         for label, place in zip(compared.labels, compared.paths, strict=True)],
        partial(_panels, "RECORDED_PANELS"),
        compared,
        conditions,
        results=[
            Cards([of_runs.recorded_table(compared), *differences], "stacked"),
            Cards(of_runs.recorded_joint_tables(compared), "three"),
        ],
        folded=(_folded_title([run.result for run in compared.runs]), [
            Cards([of_runs.recorded_timing_table(compared), of_runs.recorded_counts(compared)],
                  "stacked"),
        ]),
        footer="Each run was evaluated again from its recording, with its own scenario's funnel.",
    )  # fmt: skip


def _panels(name: str) -> list[Panel[ComparedRuns]]:
    from deploy.reports.runs import run_panels  # heavy

    panels: list[Panel[ComparedRuns]] = getattr(run_panels, name)
    return panels
