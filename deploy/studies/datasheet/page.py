"""The page of a data sheet: one sentence, one figure, the worst window, and what helps."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from deploy.judge.conditions import EFFORT
from deploy.reports.figures import joints, link, space, style
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.case_result import COMPENSATION, equipment_text, setting_text
from deploy.reports.studies.study_result import Runs
from deploy.reports.studies.study_tables import TableColumn
from deploy.reports.studies.study_texts import interval_text, losses_text
from deploy.reports.tables import ABSENT, Column, Table, table_of
from deploy.run.execute import JudgedRun
from deploy.studies.datasheet.result import DataSheetResult, caveat_text, more_windows
from deploy.studies.margin import texts
from deploy.studies.margin.result import MarginCase, MarginResult
from deploy.studies.margin.sentences import lost_at_once, model_text
from deploy.studies.margin.tables import disturbance_tables, help_tables, margin_table
from deploy.studies.margin.theory_sentences import theory_sentences
from deploy.studies.robustness.sentences import robustness_sentences
from deploy.studies.robustness.tables import robustness_table
from deploy.studies.sweep.result import Point, SweepResult
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.losses import share_kept
from deploy.study.settings import DRIVE_FEEDBACK
from deploy.study.study import rows_by

_HEIGHT_PX = 430
_MOST_POINTS = 400


class Windows(Runs):
    """The windows of a network that had the same equipment."""

    compensation: bool | None
    drive_feedback: bool | None


class DrawnSheet(NamedTuple):
    """A data sheet, and the run on the worst window of the network."""

    result: DataSheetResult
    window: JudgedRun | None


def data_sheet_page(sheet: DrawnSheet) -> Page[DrawnSheet]:
    """Return the page of a data sheet."""
    result, parts = sheet.result, sheet.result.parts
    head, *more = result.headline
    cards = [] if parts.network is None else [_network_table(result, parts.network)]
    cards += [*help_tables(parts.margin, "margin/"), margin_table(parts.margin)]
    cards += disturbance_tables(parts.margin)
    cards += [] if parts.plants is None else [robustness_table(parts.plants)]
    return Page(
        "data sheet",
        result.name,
        verdict=ReportHead("mixed", head, more),
        facts=[
            Fact("Round trip to quote", quote_text(result)),
            Fact("Arm", result.arm),
            Fact("Law", result.law or ""),
            Fact("Network", result.network or "none given"),
            Fact("Runs", f"{result.runs}"),
        ],
        panels=lambda: _panels(sheet),
        subject=sheet,
        conditions=result.conditions,
        results=[Cards(cards, "stacked")],
        footer="Each part has a report of its own, in the folders beside this file.",
    )  # fmt: skip


def headline(result: DataSheetResult) -> list[str]:
    """Return the answer, then its conditions and the rest.

    The answer is the network's verdict, if there is a network, and the number to quote. That number
    has what is not known of the arm at its worst; the arm as given is the best case.
    """
    parts, margin = result.parts, result.parts.margin
    cases = {case.compensation: case for case in margin.cases}
    network = [] if parts.network is None else _network_sentences(result, parts.network)
    quote, *numbers = _quoted_sentences(result)
    sentences = [
        *network[:1],
        quote,
        *network[1:],
        *numbers,
        *lost_at_once(margin),
        _best_case_sentence(margin, cases[True]),
    ]
    doubts = dict.fromkeys(each for case in cases.values() for each in case.doubts)
    sentences += [f"Not tested: {each}" for each in doubts]
    if parts.plants is not None:
        sentences += robustness_sentences(parts.plants)[:1]
    if result.runs_failed:
        causes = (part.commonest_error for part in parts.all.values())
        sentences.append(
            f"{result.runs_failed} of {result.runs} runs failed, most often:"
            f" {next(filter(None, causes), 'unknown')}."
        )
    return [*sentences, *theory_sentences(margin.model_copy(update={"cases": [cases[False]]}))]


def _quoted_sentences(result: DataSheetResult) -> list[str]:
    """The number to quote, of the better of both settings; then both, and what decided them."""
    margin = result.parts.margin
    best = texts.furthest_case(margin.cases)
    (other,) = (case for case in margin.cases if case is not best)
    numbers = [texts.number_text(case, margin) for case in (best, other)]
    return [
        f"{result.arm} under {result.law}: quote a round trip of {quote_text(result)}.",
        f"Round trips: {'; '.join(numbers)}.",
        *texts.unknowns_sentences(margin),
    ]


def quote_text(result: DataSheetResult) -> str:
    """The number to quote, with what it holds and what it rests on."""
    margin = result.parts.margin
    best = texts.furthest_case(margin.cases)
    caveats = "; ".join(filter(None, [texts.untested_text(best), caveat_text(result, margin)]))
    quote = f"{texts.quoted_text(best, margin)} {setting_text(best)}"
    return f"{quote} ({caveats})" if caveats else quote


def quote_of(result: DataSheetResult) -> dict[str, Any]:
    """The same for ``summary.json``."""
    best = texts.furthest_case(result.parts.margin.cases)
    return {
        "round_trip_ms": best.number, "setting": setting_text(best), "because": best.because,
        "effort": result.conditions.get(EFFORT), "text": quote_text(result),
    }  # fmt: skip


def _best_case_sentence(margin: MarginResult, on: MarginCase) -> str:
    """Name the delay of the exact arm with compensation, which is the best case."""
    any_ms = on.any_pattern
    if any_ms is None:
        return f"With compensation it keeps its bounds at no delay ({texts.loss_text(on)})."
    or_more = " or more" if on.first_failure is None else ""
    d_ms = on.guaranteed_d_ms
    playout = "" if d_ms is None else f" with a play-out of {d_ms:.9g} ms"
    return (
        f"Best case{model_text([on])}: with compensation the bounds are kept at every constant"
        f" delay up to {texts.margin_text(on, margin)}, and at any delay up to"
        f" {any_ms:g} ms{or_more}{playout}, if messages arrive in order and none is lost."
    )


def _network_sentences(result: DataSheetResult, network: SweepResult) -> list[str]:
    """Count the lost windows of the network; then their conditions, and what keeps more."""

    def kept(one: Windows) -> str:
        return f"{one.runs_kept} of {one.runs}"

    equipment = _by_equipment(network.points)
    plain = [one for one in equipment if not one.drive_feedback]
    own, best = (max(each, key=lambda one: float(one.runs_kept)) for each in (plain, equipment))
    lost, name = own.runs - own.runs_kept, Path(result.network or "").name
    interval = interval_text(own)
    verdict = f"lost in {lost} of {own.runs}" if lost else f"kept in {kept(own)}"
    quick = " (--quick)" if result.quick else ""
    sentences = [
        f"{name}: {verdict} windows of {result.duration_s:g} s {equipment_text(own)}{quick}.",
        f"95 % interval of the share of windows that are kept: {interval}"
        f" ({more_windows(own.runs)}).",
    ]
    if best.runs_kept > own.runs_kept:
        sentences.append(
            f"Kept in {kept(best)} {equipment_text(best)}: add --set {DRIVE_FEEDBACK}=true."
        )
    return sentences


def _by_equipment(points: list[Point]) -> list[Windows]:
    """Sum up the windows of a network that had the same equipment."""
    found = []
    for own in rows_by(points, lambda point: str(point.values[2:])).values():
        _, _, compensation, *feedback = own[0].values
        runs, kept = (sum(getattr(point, key) for point in own) for key in ("runs", "runs_kept"))
        found.append(Windows(
            compensation=compensation, drive_feedback=feedback[0] if feedback else None,
            runs=runs, runs_kept=kept, **share_kept(kept, runs),
            losses=sum((Counter(point.losses) for point in own), Counter()),
            loss_joints=sum((Counter(point.loss_joints) for point in own), Counter()),
            worst_point=min(own, key=_smallest_margin).worst_point,
        ))  # fmt: skip
    return found


def _smallest_margin(point: Point) -> float:
    """The smallest margin of the runs of a point; of runs that failed there is none."""
    lowest = None if point.margin_min is None else point.margin_min.lowest
    return -math.inf if lowest is None else lowest


def _network_table(result: DataSheetResult, network: SweepResult) -> Table:
    """Windows of the network that were kept, with what may help."""
    columns: list[TableColumn] = [
        (Column("Compensation", is_text=True), lambda one: COMPENSATION[one.compensation]),
        (Column("Drive loop", is_text=True),
         lambda one: COMPENSATION[one.drive_feedback]),
        (Column("Windows kept", brief="Kept"), lambda one: f"{one.runs_kept} of {one.runs}"),
        (Column("95 % interval"),
         lambda one: interval_text(one)),
        (Column("Lost by", is_text=True), lambda one: losses_text(one) or ABSENT),
        (Column("The worst, in the folder of this page", brief=None, is_text=True),
         lambda one: f"funnel-hil simulate network/scenarios/{one.worst_point}.yaml"),
    ]  # fmt: skip
    note = (
        f"Each window is {result.duration_s:g} s of the network, the same in both directions."
        " Windows begin at places spread evenly over the network, and one just before its worst"
        " half second: this one is no random place, so the share and its interval are rather low."
    )
    title = f"Windows of {Path(result.network or '').name} in which bounds are kept"
    rows = _by_equipment(network.points)
    return table_of(title, columns, rows, note)


def _panels(sheet: DrawnSheet) -> list[Panel[DrawnSheet]]:
    panels = [
        Panel(
            "Delay", "share-kept", "Share of runs or plants that keep their bounds", _share_kept,
            "Thick: the number to quote. Lines: runs of the arm as given at a constant delay, which"
            " is the best case. Dotted: the best case for any pattern of delays.", notes={
                "uncertain plants": "Each plant has other masses and friction.",
                "share of the network's round trips below": "Grey: the network's worst window.",
            },
        )
    ]  # fmt: skip
    if (window := sheet.window) is None:
        return panels
    runs = ComparedRuns([window])
    return [
        *panels,
        Panel("Worst window", "window-delay", "Delay of commands",
              lambda _: link.delay_over_time(runs),
              "From a state until its command arrives, and until it acts. The cross is the command"
              " in force when an error left its bounds for the first time."),
        Panel("Worst window", "window-error", "True errors inside their bounds",
              lambda _: joints.error_in_funnel(runs),
              "Each line should stay inside the shaded band between its bounds.", notes={
                  "outside the bounds": "The red strip at the lower edge marks the times outside."
              }),
        Panel("Worst window", "window-motion", "The arm in the worst window",
              lambda _: space.arm_motion(window.data), "Grey: where the reference wants it."),
    ]  # fmt: skip


def _share_kept(sheet: DrawnSheet) -> go.Figure:
    margin, plants = sheet.result.parts.margin, sheet.result.parts.plants
    figure = style.new_figure(_HEIGHT_PX, "round trip (ms)", "share (%)")
    if sheet.window is not None:
        trips_ms = np.sort(link.arrivals(sheet.window.data)[1])
        share = 100.0 * np.arange(1, len(trips_ms) + 1) / max(1, len(trips_ms))
        every = max(1, len(trips_ms) // _MOST_POINTS)
        figure.add_scatter(
            x=trips_ms[::every], y=share[::every], name="share of the network's round trips below",
            line_color="#bbbbbb", fill="tozeroy", mode="lines",
        )  # fmt: skip
    for index, case in enumerate(margin.cases):
        probes = sorted(case.probes, key=lambda probe: probe.value)
        name, colour = equipment_text(case), style.palette(index)
        figure.add_scatter(
            x=[probe.value for probe in probes],
            y=[100.0 * probe.runs_kept / probe.runs for probe in probes],
            name=f"arm as given, {name}", mode="lines+markers", line_color=colour, line_shape="hv",
        )  # fmt: skip
        _mark(figure, f"quote {name}", case.number, colour, "solid", width=4)
        _mark(figure, f"best case, {name}", case.any_pattern, colour, "dot")
        theory_ms = None if case.theory is None else case.theory.constant_ms
        _mark(figure, "linear theory, constant delay", theory_ms, style.INK, "dash")
    for robust in () if plants is None else plants.cases:
        figure.add_scatter(
            x=[at.value for at in robust.values],
            y=[100.0 * (at.fraction or 0.0) for at in robust.values],
            name="uncertain plants", mode="lines+markers", line_color=style.palette(2),
        )  # fmt: skip
    figure.update_yaxes(range=[0.0, 103.0])
    style.put_legend_on_top(figure, 1 + len(figure.data) // 3)
    return figure


def _mark(
    figure: go.Figure, name: str, at_ms: float | None, colour: str, dash: str, width: int = 1
) -> None:
    """Draw a margin as an upright line, with its value in the legend."""
    if at_ms is not None:
        figure.add_scatter(
            x=[at_ms, at_ms], y=[0.0, 100.0], name=f"{name}: {at_ms:g} ms", mode="lines",
            line={"color": colour, "dash": dash, "width": width},
        )  # fmt: skip
