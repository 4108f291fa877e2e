"""Pages of runs: of one, of several laws, of recorded runs side by side.

Each function lists the tables, facts, sentences and figures of its page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from deploy.judge.conditions import conditions_of_recording
from deploy.judge.findings.link_delays import link_sentence, playout_sentence
from deploy.judge.link_words import link_words
from deploy.judge.metrics import RunResult
from deploy.judge.result.transport import Channel
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.runs import run_numbers
from deploy.reports.runs import run_tables as of_run
from deploy.reports.runs.run_numbers import margin_place
from deploy.reports.tables import margin_text, number, percent
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.study.comparison.compared_runs import ComparedRuns


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
            Fact(run_numbers.DEADLINES_MET, percent(result.timing.on_time_rate),
                 "share of the ticks that met their deadline and were not skipped"),
            Fact("Digest", result.digest[:12], result.digest),
        ],
        _panels_of_run,
        ComparedRuns([run]),
        conditions_of_recording(run.data, manifest),
        heading=(f"{result.scenario} · {result.law} · {link_words(run.data.setup.link, manifest)} ·"
                 f" {result.duration_s:g} s · {result.clock}"),
        results=[
            Cards([of_run.joint_table(result, from_s, run.data.setup.robot.slides)]),
            Cards(of_run.confirmation_tables([result.confirmation])),
        ],
        folded=(folded_title([result]), [
            Cards([of_run.timing_table(result), of_run.health_table(result),
                   of_run.transport_table(result)], "three"),
            Cards([of_run.event_table(run.data)]),
        ]),
        lines=_run_lines(result),
        end_s=result.duration_s,
        footer="Digest of the delivered joint states and commands (SHA-256):",
        footer_code=result.digest,
    )  # fmt: skip


def folded_title(results: Sequence[RunResult]) -> str:
    """Return the title of what is only read where something is odd in a run, and what is."""
    ways = [way for each in results for way in (each.transport.uplink, each.transport.downlink)]
    counts = {
        "deadlines missed": sum(each.timing.late_ticks or 0 for each in results),
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
    factor, rate = result.real_time_factor, result.timing.on_time_rate
    counts = [
        f"{result.ticks:,} ticks",
        *([_deadline_text(result, rate)] if rate is not None else []),
        *([f"real-time factor {factor:.2f}"] if factor is not None else []),
        f"digest {result.digest[:16]}",
    ]
    lines = [*(_link_lines(result) if result.ticks else []), ", ".join(counts)]
    if skipped := result.recording.ticks_skipped:
        sent = number(result.transport.uplink.sent)
        ticks = "1 tick, which counts" if skipped == 1 else f"{skipped:,} ticks, which count"
        lines.append(f"the plant was late: it skipped {ticks} as missed, and sent {sent} states")
    return lines


def _deadline_text(result: RunResult, rate: float) -> str:
    """Say how many ticks met their deadline; in virtual time, only a link's delay can miss it."""
    if result.clock == "realtime":
        return f"deadlines met {percent(rate)}"
    return f"commands younger than link.deadline_ms at {percent(rate)}"


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


def _panels_of_run() -> list[Panel[ComparedRuns]]:
    from deploy.reports.runs.run_panels import panels_of_run  # heavy

    return panels_of_run()


def panels_of(name: str) -> list[Panel[ComparedRuns]]:
    """Return the panels in a list of `run_panels`, which is heavy to import."""
    from deploy.reports.runs import run_panels  # heavy

    panels: list[Panel[ComparedRuns]] = getattr(run_panels, name)
    return panels
