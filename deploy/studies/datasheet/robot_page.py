"""The page of a robot's data sheet: how far the tip is behind, which reflex, which delay loses."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from deploy.judge.verdict import Verdict
from deploy.reports.figures import style
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.study_tables import TableColumn
from deploy.reports.tables import ABSENT, Cell, Column, Table, number, table_of
from deploy.studies.datasheet.robot_sheet import NO_NETWORK, SHOWN_MS
from deploy.studies.margin import texts
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.tables import margin_table
from deploy.studies.margin.theory_sentences import theory_sentences
from deploy.study.study import rows_by

Summary = dict[str, Any]
_WITH = {False: "without", True: "with"}
_HEIGHT_PX = 380
_OPTIONS = ("preview", "limiter", "compensation")


def robot_sheet_page(summary: Summary) -> Page[Summary]:
    """Return the page of a robot's data sheet."""
    head, *more = summary["headline"]
    margin = MarginResult.model_validate(summary["margin"])
    return Page(
        "data sheet",
        summary["name"],
        verdict=ReportHead("mixed", head, more),
        facts=[
            Fact("Arm", summary["arm"]),
            Fact("Interface", summary["interface"]),
            Fact("Network", summary["network"] or "none given"),
            Fact("Runs", f"{summary['runs']}"),
        ],
        panels=lambda: [
            Panel("Tip", "tip-error", "Largest distance of the tip from the reference", _tip_errors,
                  "One bar for each run; runs that a fault ended have none.", is_clickable=True)
        ],
        subject=summary,
        conditions=summary["conditions"],
        results=[Cards([_ways_table(summary), margin_table(margin)], "stacked"),
                 Cards([_runs_table(summary)], "stacked")],
        footer="The search for margins has a report of its own: margin/report.html.",
    )  # fmt: skip


def headline(summary: Summary) -> list[str]:
    """Return what the tip does with and without a preview, the reflexes, and the margin."""
    margin = MarginResult.model_validate(summary["margin"])
    tip = filter(None, (_tip_sentence(summary, law) for law in _laws(summary)))
    return [
        *tip,
        *_kept_sentences(summary),
        *_reflex_sentences(summary),
        _margin_sentence(summary, margin),
        *theory_sentences(margin.model_copy(update={"cases": margin.cases[:1]})),
    ]


def way_text(way: Summary) -> str:
    """Return the law of a way to drive a robot, and what varies of it."""
    options = [f"{_WITH[way[name]]} {name}" for name in _OPTIONS if way[name] is not None]
    return ", ".join([way["law"], *options])


def summaries_of(runs: list[Summary]) -> list[Summary]:
    """Sum up the runs of each way to drive a robot, without those on no network."""
    return [_summary_of(own) for own in rows_by(_asked(runs), way_text).values()]


def _summary_of(runs: list[Summary]) -> Summary:
    """Sum up runs that were driven alike; errors are those of runs without a fault."""
    ended = [run for run in runs if not run["faults"]]
    lags = [run for run in ended if run["lag_ms"] is not None]
    slowest = max(lags, key=lambda run: abs(run["lag_ms"]), default=None)
    worst = max(runs, key=_badness)
    return {
        "way": way_text(runs[0]),
        **{name: runs[0][name] for name in ("law", *_OPTIONS)},
        "runs": len(runs),
        "kept": sum(run["kept"] for run in runs),
        "tip_rms_mm": _largest(ended, "tip_rms_mm"),
        "tip_largest_mm": _largest(ended, "tip_largest_mm"),
        "lag_ms": None if slowest is None else slowest["lag_ms"],
        "lag_joint": None if slowest is None else slowest["lag_joint"],
        "reflexes": dict(Counter(each["kind"] for run in runs for each in run["reflexes"][:1])),
        "worst": worst["link"],
        "command": worst["command"],
    }


def _asked(runs: list[Summary]) -> list[Summary]:
    return [run for run in runs if run["link"] != NO_NETWORK]


def _badness(run: Summary) -> tuple[bool, bool, float]:
    return bool(run["faults"]), not run["kept"], run["tip_largest_mm"] or 0.0


def _largest(runs: list[Summary], name: str) -> float | None:
    return max((run[name] for run in runs if run[name] is not None), default=None)


def _laws(summary: Summary) -> list[str]:
    return list(dict.fromkeys(run["law"] for run in summary["runs_of_robot"]))


def _tip_sentence(summary: Summary, law: str) -> str:
    """Compare the tip without a preview and with it; return nothing where none is tried."""
    runs = [run for run in _asked(summary["runs_of_robot"]) if run["law"] == law]
    shown, where = f"{SHOWN_MS:g} ms", _where(summary)
    if any(run["link"] == shown for run in runs):
        runs, where = [run for run in runs if run["link"] == shown], f"a round trip of {shown}"
    without, having = ([run for run in runs if run["preview"] is on] for on in (False, True))
    if not (without and having):
        return ""
    before, after = _tip_text(_summary_of(without)), _tip_text(_summary_of(having))
    return f"{law} over {where}: {before} without preview; {after} with it."


def _tip_text(found: Summary) -> str:
    """Say the tip's distance and the lag of its slowest joint, as far as they are known."""
    parts = []
    if (largest_mm := found["tip_largest_mm"]) is not None:
        parts.append(f"the tip is up to {number(largest_mm, unit=' mm')} away")
    if (lag_ms := found["lag_ms"]) is not None:
        side = "behind" if lag_ms >= 0.0 else "ahead"
        lag = f"{number(abs(lag_ms), unit=' ms')} {side} ({found['lag_joint']})"
        parts.append(lag if parts else f"joints are up to {lag}")
    return " and ".join(parts) or "nothing is known, as every run ended by a fault or at rest,"


def _where(summary: Summary) -> str:
    if summary["network"] is None:
        return "the given link"
    return f"{_windows(summary)} windows of {Path(summary['network']).name}"


def _windows(summary: Summary) -> int:
    return len({run["link"] for run in _asked(summary["runs_of_robot"])})


def _kept_sentences(summary: Summary) -> list[str]:
    """Count the windows of a network that are kept, by the best way and by the others."""
    if summary["network"] is None:
        return []
    ways = sorted(summary["ways"], key=lambda way: -way["kept"])
    kept = "; ".join(f"{way['kept']} of {way['runs']} {way['way']}" for way in ways)
    name = Path(summary["network"]).name
    return [f"{name}: windows of {summary['duration_s']:g} s in which bounds are kept: {kept}."]


def _reflex_sentences(summary: Summary) -> list[str]:
    """Name the reflexes that stopped the robot, by limiter; and those without any network."""
    found = []
    runs = summary["runs_of_robot"]
    limiters = sorted({run["limiter"] for run in runs}, key=bool)
    parts = [
        f"{'' if on is None else f'{_WITH[on]} limiter: '}{_reflexes_text(_asked(own))}"
        for on in limiters
        for own in ([run for run in runs if run["limiter"] is on],)
    ]
    found.append(f"Reflexes: {'; '.join(parts)}.")
    bare = [run for run in runs if run["link"] == NO_NETWORK and run["reflexes"]]
    if bare:
        found.append(f"Also without any delay: {_reflexes_text(bare)}.")
    return found


def _reflexes_text(runs: list[Summary]) -> str:
    """Name the first reflexes of runs, their number, and the time of the earliest."""
    stopped = [(run["reflexes"][0], run) for run in runs if run["reflexes"]]
    if not stopped:
        return "none"
    sentences = []
    for kind, count in Counter(reflex["kind"] for reflex, _ in stopped).most_common():
        alike = [each for each in stopped if each[0]["kind"] == kind]
        earliest, run = min(alike, key=lambda each: float(each[0]["time_s"]))
        of_joint = f" of {earliest['joint']}" if earliest["joint"] else ""
        when = f"first at {earliest['time_s']:.3f} s{of_joint}, {run['link']}, {way_text(run)}"
        sentences.append(f"{kind} in {count} of {len(runs)} runs ({when})")
    return ", ".join(sentences)


def _margin_sentence(summary: Summary, margin: MarginResult) -> str:
    """The number to quote of the loop around the robot."""
    numbers = [
        f"{texts.quoted_text(case, margin)} {texts.setting_and_reason(case)}".rstrip()
        for case in margin.cases
    ]
    law = margin.cases[0].law
    return f"{summary['arm']}, {summary['interface']} under {law}: quote a round trip of" + (
        f" {'; '.join(numbers)}."
    )


def _ways_table(summary: Summary) -> Table:
    columns: list[TableColumn] = [
        (Column("Way", is_text=True), lambda way: way["way"]),
        (Column("Kept"), lambda way: f"{way['kept']} of {way['runs']}"),
        (Column("Tip, RMS", "mm"), lambda way: way["tip_rms_mm"]),
        (Column("Tip, largest", "mm"), lambda way: way["tip_largest_mm"]),
        (Column("Behind", "ms"), lambda way: way["lag_ms"]),
        (Column("Reflexes", is_text=True),
         lambda way: ", ".join(f"{n} × {kind}" for kind, n in way["reflexes"].items()) or ABSENT),
    ]  # fmt: skip
    note = "The worst of the runs of each way; errors are those of runs that no fault ended."
    return table_of(f"Ways to drive {summary['interface']}", columns, summary["ways"], note)


def _tip_errors(summary: Summary) -> go.Figure:
    """Draw the largest distance of the tip over the links, for each way to drive the robot."""
    figure = style.new_figure(_HEIGHT_PX, summary["network"] or "round trip", "mm")
    for index, (way, runs) in enumerate(rows_by(summary["runs_of_robot"], way_text).items()):
        ended = [run for run in runs if not run["faults"]]
        figure.add_bar(
            x=[run["link"] for run in ended], y=[run["tip_largest_mm"] for run in ended],
            customdata=[run["command"] for run in ended],
            name=way, marker_color=style.palette(index),
        )  # fmt: skip
    figure.update_layout(barmode="group", showlegend=True, legend_orientation="h", legend_y=1.15)
    return figure.update_yaxes(type="log", dtick=1)


def _runs_table(summary: Summary) -> Table:
    def verdict(run: Summary) -> Cell:
        return Cell(Verdict(run["verdict"]).listed, "good" if run["kept"] else "bad")

    def reflexes(run: Summary) -> str:
        names = (f"{each['kind']} at {each['time_s']:.3f} s" for each in run["reflexes"][:1])
        return next(names, ABSENT)

    columns: list[TableColumn] = [
        (Column("Link", is_text=True), lambda run: run["link"]),
        (Column("Way", is_text=True), way_text),
        (Column("Verdict", is_text=True), verdict),
        (Column("Tip, RMS", "mm"), lambda run: run["tip_rms_mm"]),
        (Column("Tip, largest", "mm"), lambda run: run["tip_largest_mm"]),
        (Column("Behind", "ms"), lambda run: run["lag_ms"]),
        (Column("Reflex", is_text=True), reflexes),
    ]
    return table_of("All runs", columns, summary["runs_of_robot"], most_printed=0)
