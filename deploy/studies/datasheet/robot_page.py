"""The page of a robot's data sheet: how far the tip is behind, which reflex, which delay loses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import plotly.graph_objects as go

from deploy.judge.verdict import Verdict
from deploy.reports.figures import style
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.case_result import COMPENSATION
from deploy.reports.studies.study_tables import TableColumn, shown_columns
from deploy.reports.tables import ABSENT, Cell, Column, Table, number, table_of
from deploy.studies.datasheet.result import (
    NO_NETWORK,
    RobotRun,
    RobotSheetResult,
    WayResult,
    caveat_text,
)
from deploy.studies.datasheet.robot_sheet import SHOWN_MS
from deploy.studies.margin import texts
from deploy.studies.margin.result import MarginCase
from deploy.studies.margin.tables import margin_table
from deploy.studies.margin.theory_sentences import theory_sentences
from deploy.study.study import rows_by

_HEIGHT_PX = 380
_PLAYOUT = "link.playout_ms"


def robot_sheet_page(result: RobotSheetResult) -> Page[RobotSheetResult]:
    """Return the page of a robot's data sheet."""
    head, *more = result.headline
    return Page(
        "data sheet",
        result.name,
        verdict=ReportHead("mixed", head, more),
        facts=[
            Fact("Arm", result.arm),
            Fact("Interface", result.interface),
            Fact("Network", result.network or "none given"),
            Fact("Runs", f"{result.runs}"),
        ],
        panels=lambda: [
            Panel("Tip", "tip-error", "Largest distance of the tip from the reference", _tip_errors,
                  "One bar for each run; runs that a fault ended have none.", is_clickable=True)
        ],
        subject=result,
        conditions=result.conditions,
        results=[Cards([_ways_table(result), margin_table(result.margin)], "stacked"),
                 Cards([_runs_table(result)], "stacked")],
        footer="The search for margins has a report of its own: margin/report.html.",
    )  # fmt: skip


def headline(result: RobotSheetResult) -> list[str]:
    """Return the answer: windows of the network, or a margin; then the tip, reflexes and theory."""
    margin = result.margin
    tip = (_tip_sentence(result, *own) for own in rows_by(result.asked, lambda r: r.law).items())
    return [
        *_kept_sentences(result),
        *_margin_sentences(result),
        *filter(None, tip),
        *_reflex_sentences(result),
        *theory_sentences(margin.model_copy(update={"cases": margin.cases[:1]})),
        *(["A stable loop can still leave its bounds."] if _is_stable(margin.cases[0]) else []),
    ]


def _is_stable(case: MarginCase) -> bool:
    """Whether theory finds the loop stable, without a delay at least."""
    theory = case.theory
    return theory is not None and theory.reason is None and theory.unstable_without_delay is None


def ways_of(runs: Iterable[RobotRun]) -> list[WayResult]:
    """Sum up the runs of each way to drive a robot."""
    return [_way_of(own) for own in rows_by(runs, lambda run: run.text).values()]


def _way_of(runs: list[RobotRun]) -> WayResult:
    """Sum up runs that were driven alike; errors are those of runs without a fault."""
    ended = [run for run in runs if not run.faults]
    lags = [run for run in ended if run.lag_ms is not None]
    slowest = max(lags, key=lambda run: abs(run.lag_ms or 0.0), default=None)
    worst = max(runs, key=_badness)
    return WayResult(
        way=worst.text, law=worst.law, **worst.options, runs=len(runs),
        kept=sum(run.kept for run in runs),
        tip_rms_mm=_largest([run.tip_rms_mm for run in ended]),
        tip_largest_mm=_largest([run.tip_largest_mm for run in ended]),
        lag_ms=None if slowest is None else slowest.lag_ms,
        lag_joint=None if slowest is None else slowest.lag_joint,
        reflexes=dict(Counter(each.kind for run in runs for each in run.reflexes[:1])),
        worst=worst.link, command=worst.command,
    )  # fmt: skip


def _badness(run: RobotRun) -> tuple[bool, bool, float]:
    return bool(run.faults), not run.kept, run.tip_largest_mm or 0.0


def _largest(values: list[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _tip_sentence(result: RobotSheetResult, law: str, runs: list[RobotRun]) -> str:
    """Compare the tip without a preview and with it; return nothing where none is tried."""
    shown, where = f"{SHOWN_MS:g} ms", _where(result)
    if any(run.link == shown for run in runs):
        runs, where = [run for run in runs if run.link == shown], f"a round trip of {shown}"
    without, having = ([run for run in runs if run.preview is on] for on in (False, True))
    if not (without and having):
        return ""
    before, after = _tip_text(_way_of(without)), _tip_text(_way_of(having))
    each = f"one run of {result.duration_s:g} s each"
    return f"{law} over {where}, {each}: without preview {before}; with it {after}."


def _tip_text(found: WayResult) -> str:
    """Say the tip's distance and the lag of its slowest joint, as far as they are known."""
    parts = []
    if (largest_mm := found.tip_largest_mm) is not None:
        parts.append(f"the tip is up to {number(largest_mm, unit=' mm')} away")
    if (lag_ms := found.lag_ms) is not None:
        side = "behind" if lag_ms >= 0.0 else "ahead"
        parts.append(f"{found.lag_joint} is {number(abs(lag_ms), unit=' ms')} {side}")
    return " and ".join(parts) or "nothing is known, as every run ended by a fault or at rest"


def _where(result: RobotSheetResult) -> str:
    if result.network is None:
        return "the given link"
    return f"{len({run.link for run in result.asked})} windows of {Path(result.network).name}"


def _kept_sentences(result: RobotSheetResult) -> list[str]:
    """Count the windows of a network that the best way keeps, and those of the others."""
    if result.network is None:
        return []
    best, *others = sorted(result.ways, key=lambda way: -way.kept)
    windows = f"windows of {result.duration_s:g} s of {Path(result.network).name}"
    more = f" ({'--quick; ' * result.quick}more windows: --windows {2 * best.runs})"
    if not best.kept:
        each = f", in each of the {len(others) + 1} ways tried" if others else f", {best.way}"
        return [f"{_subject(result)}: bounds are lost in all {best.runs} {windows}{each}{more}."]
    rest = "; ".join(f"{way.kept} of {way.runs} {way.way}" for way in others)
    at_best = " at best" if others else ""
    return [
        f"{_subject(result)}: bounds are kept in {best.kept} of {best.runs} {windows}{at_best}"
        f", {best.way}{more}.",
        *([f"Other ways: {rest}."] if rest else []),
    ]


def _subject(result: RobotSheetResult) -> str:
    return f"{result.arm} over {result.interface}"


def _reflex_sentences(result: RobotSheetResult) -> list[str]:
    """Name the reflexes that stopped the robot, by limiter; and those without any network."""
    by_limiter = rows_by(result.asked, lambda run: run.limiter)
    parts = [
        f"{'' if on is None else f'{COMPENSATION[on]} limiter: '}{_reflexes_text(by_limiter[on])}"
        for on in sorted(by_limiter, key=bool)
    ]
    bare = [run for run in result.runs_of_robot if run.link == NO_NETWORK and run.reflexes]
    without = [f"Also without any delay: {_reflexes_text(bare)}."] if bare else []
    return [f"Reflexes: {'; '.join(parts)}.", *without]


def _reflexes_text(runs: list[RobotRun]) -> str:
    """Name the first reflexes of runs, their number, and the time of the earliest."""
    stopped = rows_by((run for run in runs if run.reflexes), lambda run: run.reflexes[0].kind)
    sentences = []
    for kind, alike in sorted(stopped.items(), key=lambda item: -len(item[1])):
        run = min(alike, key=lambda each: each.reflexes[0].time_s)
        first = run.reflexes[0]
        of_joint = f" of {first.joint}" if first.joint else ""
        when = f"first at {first.time_s:.3f} s{of_joint}, {run.link}, {run.text}"
        sentences.append(f"{kind} in {len(alike)} of {len(runs)} runs ({when})")
    return ", ".join(sentences) or "none"


def _margin_sentences(result: RobotSheetResult) -> list[str]:
    """The number to quote of the loop around the robot; only beside it, if a network loses it."""
    margin = result.margin
    numbers = "; ".join(texts.number_text(case, margin) for case in margin.cases)
    law = margin.cases[0].law
    is_previewed = any(run.preview for run in result.asked if run.law == law)
    known = "trajectory known in advance" if is_previewed else ""
    limiter = "with limiter" if any(run.limiter for run in result.asked) else ""
    rests_on = "; ".join(filter(None, [known, limiter, caveat_text(result, margin)]))
    conditions = f" ({rests_on})" if rests_on else ""
    quote = f"{_subject(result)} under {law}: quote a round trip of {numbers}, constant"
    is_lost = result.network is not None and all(way.kept < way.runs for way in result.ways)
    if is_lost:
        quote = (
            f"Delays that do not vary are easier: {law} keeps them up to a round trip of {numbers}"
        )
    sentences = [f"{quote}{conditions}."]
    is_set = _PLAYOUT in result.conditions.get("set", "")
    if is_lost and result.smooth_playout_ms is not None and not is_set:
        sentences.append(
            f"What often helps: --set {_PLAYOUT}={result.smooth_playout_ms:g}: targets act so long"
            " after their states, when 99 % of them have arrived."
        )
    if is_previewed:
        sentences.append("For a trajectory not known in advance: --set controller.preview_ms=0.")
    return sentences


def _ways_table(result: RobotSheetResult) -> Table:
    columns: list[TableColumn] = [
        (Column("Way", is_text=True), lambda way: way.way),
        (Column("Kept"), lambda way: f"{way.kept} of {way.runs}"),
        *shown_columns(WayResult),
        (Column("Reflexes", is_text=True),
         lambda way: ", ".join(f"{n} × {kind}" for kind, n in way.reflexes.items()) or ABSENT),
    ]  # fmt: skip
    note = "The worst of the runs of each way; errors are those of runs that no fault ended."
    return table_of(f"Ways to drive {result.interface}", columns, result.ways, note)


def _tip_errors(result: RobotSheetResult) -> go.Figure:
    """Draw the largest distance of the tip over the links, for each way to drive the robot."""
    figure = style.new_figure(_HEIGHT_PX, result.network or "round trip", "mm")
    for index, (way, runs) in enumerate(rows_by(result.runs_of_robot, lambda r: r.text).items()):
        ended = [run for run in runs if not run.faults]
        figure.add_bar(
            x=[run.link for run in ended], y=[run.tip_largest_mm for run in ended],
            customdata=[run.command for run in ended], name=way, marker_color=style.palette(index),
        )  # fmt: skip
    figure.update_layout(barmode="group")
    style.put_legend_on_top(figure, 1 + len(figure.data) // 4)
    ticks = [float(f"{digit}e{power}") for power in range(-3, 5) for digit in (1, 2, 5)]
    return figure.update_yaxes(type="log", tickvals=ticks, ticktext=[f"{at:g}" for at in ticks])


def _runs_table(result: RobotSheetResult) -> Table:
    def verdict(run: RobotRun) -> Cell:
        return Cell(Verdict(run.verdict).listed, "good" if run.kept else "bad")

    def reflex(run: RobotRun) -> str:
        return next((f"{each.kind} at {each.time_s:.3f} s" for each in run.reflexes), ABSENT)

    columns: list[TableColumn] = [
        (Column("Link", is_text=True), lambda run: run.link),
        (Column("Way", is_text=True), lambda run: run.text),
        (Column("Verdict", is_text=True), verdict),
        *shown_columns(RobotRun),
        (Column("Reflex", is_text=True), reflex),
    ]
    return table_of("All runs", columns, result.runs_of_robot, most_printed=0)
