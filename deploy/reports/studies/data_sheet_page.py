"""The page of a data sheet: one sentence, one figure, the worst window, and what helps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from bus_schema.messages.topics import PLANT_TRUTH
from deploy.reports.figures import joints, space, style
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.studies import study_tables as tables
from deploy.reports.studies import study_texts as texts
from deploy.reports.tables import Cell, Column, Table
from deploy.reports.verdict_texts import ReportHead
from deploy.run.execute import JudgedRun
from deploy.study.comparison.comparison import ComparedRuns
from deploy.study.data_sheet import any_pattern_ms

Summary = dict[str, Any]
_HEIGHT_PX, _SHORT_PX = 430, 260
_MOST_POINTS = 400


class DrawnSheet(NamedTuple):
    """A data sheet: its summary, and the run on the worst window of the network."""

    summary: Summary
    window: JudgedRun | None


def data_sheet_page(sheet: DrawnSheet) -> Page[DrawnSheet]:
    """Return the page of a data sheet."""
    summary = sheet.summary
    parts = summary["parts"]
    margin, plants = parts["margin"], parts.get("plants")
    head, *more = summary["headline"]
    cards = [*_help_tables(margin), tables.margin_table(margin), *tables.disturbance_tables(margin)]
    cards += [] if plants is None else [tables.robustness_table(plants)]
    return Page(
        "data sheet",
        summary["name"],
        verdict=ReportHead("mixed", head, more),
        facts=[
            Fact("Arm", summary["arm"]),
            Fact("Law", summary["law"]),
            Fact("Network", summary["network"] or "none given"),
            Fact("Runs", f"{summary['runs']}"),
        ],
        panels=lambda: _panels(sheet),
        subject=sheet,
        conditions=summary["conditions"],
        results=[Cards(cards, "stacked")],
        lines=texts.margin_sentences(margin),
        footer="Each part has a report of its own, in the folders beside this file.",
    )  # fmt: skip


def _help_tables(margin: Summary) -> list[Table]:
    """Return what was tried at the first failure of each case, with the command of the best."""
    found = []
    for case in margin["cases"]:
        if (helps := case.get("what_helps")) is None:
            continue
        best = helps["best"] or {"change": None, "command": ""}
        rows = [
            [each["change"], Cell("yes" if each["held"] else "no"),
             None if each["margin_min"] is None else 100.0 * each["margin_min"],
             best["command"] if each["change"] == best["change"] else ""]
            for each in helps["tried"]
        ]  # fmt: skip
        columns = [
            Column("Change", is_text=True),
            Column("Kept", is_text=True),
            Column("Bound left", "%"),
            Column("Command", brief=None, is_text=True),
        ]
        title = (
            f"What helps at {texts.value_text(helps['value'], margin)}, {texts.case_title(case)}"
        )
        found.append(Table(title, columns, rows))
    return found


def headline(summary: Summary) -> list[str]:
    """Return the answer in one sentence, then what was found on the network and of plants."""
    parts = summary["parts"]
    cases = {case["compensation"]: case for case in parts["margin"]["cases"]}
    sentences = [_margin_sentence(summary, parts["margin"], cases[True], cases[False])]
    doubts = dict.fromkeys(each for case in cases.values() for each in case["doubts"])
    sentences += [f"Not tested: {each}" for each in doubts]
    if (network := parts.get("network")) is not None:
        point = network["points"][0]
        kept, runs = point["runs_kept"], point["runs"]
        sentences.append(
            f"On {summary['network']}, with compensation, it kept them in {kept} of {runs} windows"
            f" of {summary['duration_s']:g} s."
        )
    if summary["runs_failed"]:
        sentences.append(
            f"{summary['runs_failed']} of {summary['runs']} runs failed: see the parts."
        )
    if (plants := parts.get("plants")) is not None:
        sentences += texts.robustness_sentences(plants)[:1]
    return sentences


def _margin_sentence(summary: Summary, margin: Summary, on: Summary, off: Summary) -> str:
    who, any_ms = f"{summary['arm']} under {summary['law']}", any_pattern_ms(on)
    if any_ms is None:
        without = "" if off["margin"] is None else f" (constant: {texts.margin_text(off, margin)})"
        at_all = "only without compensation" + without if without else "at no delay"
        return f"{who} keeps its bounds {at_all}."
    at_least = "≥ " if on["first_failure"] is None else ""
    return (
        f"{who} keeps its bounds for any delay up to {at_least}{any_ms:g} ms with"
        " compensation (round trip; messages in order, none lost); constant:"
        f" {texts.margin_text(on, margin)} with it, {texts.margin_text(off, margin)} without."
    )


def _panels(sheet: DrawnSheet) -> list[Panel[DrawnSheet]]:
    panels = [
        Panel(
            "Delay", "share-kept", "Share of runs or plants that keep their bounds", _share_kept,
            "Lines: runs of the exact arm at a constant delay, and uncertain plants. Dotted:"
            " margins. Grey: the share of round trips of the worst window below a delay.",
        )
    ]  # fmt: skip
    if (window := sheet.window) is None:
        return panels
    runs = ComparedRuns([window])
    return [
        *panels,
        Panel("Worst window", "window-delay", "Round trip of each command over time",
              lambda _: _round_trips(window), "The round trip of each command that arrived."),
        Panel("Worst window", "window-error", "True errors inside their bounds",
              lambda _: joints.error_in_funnel(runs), "Red marks are ticks outside the funnel."),
        Panel("Worst window", "window-motion", "The arm in the worst window",
              lambda _: space.arm_motion(window.data), "Grey: where the reference wants it."),
    ]  # fmt: skip


def _share_kept(sheet: DrawnSheet) -> go.Figure:
    parts = sheet.summary["parts"]
    figure = style.new_figure(_HEIGHT_PX, "round trip (ms)", "kept (%)")
    if sheet.window is not None:
        trips_ms = np.sort(_round_trips_ms(sheet.window)[1])
        share = 100.0 * np.arange(1, len(trips_ms) + 1) / max(1, len(trips_ms))
        every = max(1, len(trips_ms) // _MOST_POINTS)
        figure.add_scatter(
            x=trips_ms[::every], y=share[::every], name="round trips below", line_color="#bbbbbb",
            fill="tozeroy", mode="lines",
        )  # fmt: skip
    for index, case in enumerate(parts["margin"]["cases"]):
        probes = sorted(case["probes"], key=lambda probe: float(probe["value"]))
        figure.add_scatter(
            x=[probe["value"] for probe in probes],
            y=[100.0 * probe["runs_kept"] / probe["runs"] for probe in probes],
            name="with compensation" if case["compensation"] else "without compensation",
            mode="lines+markers", line_color=style.palette(index), line_shape="hv",
        )  # fmt: skip
        if case["margin"] is not None:
            figure.add_vline(x=case["margin"], line=style.DOTTED)
    for case in (parts.get("plants") or {"cases": ()})["cases"]:
        figure.add_scatter(
            x=[at["value"] for at in case["values"]],
            y=[100.0 * at["fraction"] for at in case["values"]],
            name="uncertain plants", mode="lines+markers", line_color=style.palette(2),
        )  # fmt: skip
    figure.update_yaxes(range=[0.0, 103.0])
    style.put_legend_on_top(figure, 1 + len(figure.data) // 3)
    return figure


def _round_trips_ms(window: JudgedRun) -> tuple[Any, Any]:
    """Return times in s and round trips in ms of the commands that arrived."""
    truth = window.data.tables[PLANT_TRUTH.name]
    arrived = truth["round_trip_ns"] >= 0
    return window.data.times_s(PLANT_TRUTH)[arrived], 1e-6 * truth["round_trip_ns"][arrived]


def _round_trips(window: JudgedRun) -> go.Figure:
    times_s, trips_ms = style.decimate(*_round_trips_ms(window))
    figure = style.new_figure(_SHORT_PX, "time (s)", "round trip (ms)")
    figure.add_trace(style.line(times_s, trips_ms, style.palette(0), "round trip"))
    return figure
