"""The page of a data sheet: one sentence, one figure, the worst window, and what helps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from deploy.reports.figures import joints, link, space, style
from deploy.reports.page import Cards, Fact, Page, Panel
from deploy.reports.studies import study_tables as tables
from deploy.reports.studies import study_texts as texts
from deploy.reports.tables import ABSENT, Column, Table, table_of
from deploy.reports.verdict_texts import ReportHead
from deploy.run.execute import JudgedRun
from deploy.study.comparison.comparison import ComparedRuns
from deploy.study.data_sheet import any_pattern_ms
from deploy.study.losses import share_kept

Summary = dict[str, Any]
_HEIGHT_PX = 430
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
    cards = [] if "network" not in parts else [_network_table(summary)]
    cards += [*tables.help_tables(margin, "margin/"), tables.margin_table(margin)]
    cards += tables.disturbance_tables(margin)
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
        footer="Each part has a report of its own, in the folders beside this file.",
    )  # fmt: skip


def headline(summary: Summary) -> list[str]:
    """Return the answer in one sentence, then what was found on the network and of plants."""
    parts = summary["parts"]
    margin, plants = parts["margin"], parts.get("plants")
    cases = {case["compensation"]: case for case in margin["cases"]}
    sentences = [_margin_sentence(summary, margin, cases[True], cases[False])]
    doubts = dict.fromkeys(each for case in cases.values() for each in case["doubts"])
    sentences += [f"Not tested: {each}" for each in doubts]
    if (network := parts.get("network")) is not None:
        sentences.append(_network_sentence(summary, network["points"]))
    if plants is not None:
        sentences += texts.robustness_sentences(plants)[:1]
    if summary["runs_failed"]:
        sentences.append(
            f"{summary['runs_failed']} of {summary['runs']} runs failed: see the parts."
        )
    return [*sentences, *texts.theory_sentences({**margin, "cases": [cases[False]]})]


def _margin_sentence(summary: Summary, margin: Summary, on: Summary, off: Summary) -> str:
    who, any_ms = f"{summary['arm']} under {summary['law']}", any_pattern_ms(on)
    if any_ms is None:
        without = "" if off["margin"] is None else f" (constant: {texts.margin_text(off, margin)})"
        at_all = "only without compensation" + without if without else "at no delay"
        return f"{who} keeps its bounds {at_all}."
    or_more = " or more" if on["first_failure"] is None else ""
    return (
        f"{who} keeps its bounds for any delay up to {any_ms:g} ms{or_more} with"
        f" compensation{texts.model_text([on])} (round trip; messages in order, none lost);"
        f" constant: {texts.margin_text(on, margin)} with it, {texts.margin_text(off, margin)}"
        " without."
    )


def _network_sentence(summary: Summary, points: list[Summary]) -> str:
    """How many windows of the network were kept, and whether drive feedback helps."""

    def windows(point: Summary) -> str:
        interval = texts.interval_text(share_kept(point["runs_kept"], point["runs"]))
        return f"{point['runs_kept']} of {point['runs']} windows (95 % interval {interval})"

    own, best = points[0], max(points, key=lambda point: point["runs_kept"])
    better = ""
    if best["runs_kept"] > own["runs_kept"]:
        better = f"; {texts.equipment_text(_equipment(best))}, in {windows(best)}"
    return (
        f"On {summary['network']}, with compensation, it kept them in {windows(own)} of"
        f" {summary['duration_s']:g} s{better}."
    )


def _equipment(point: Summary) -> Summary:
    """Whether runs of a network had delay compensation, and feedback at the drives."""
    _, compensation, *feedback = point["values"]
    return {"compensation": compensation, "drive_feedback": feedback[0] if feedback else None}


def _network_table(summary: Summary) -> Table:
    """Windows of the network that were kept, with what may help."""
    network = summary["parts"]["network"]
    columns: list[tables.TableColumn] = [
        (Column("Compensation", is_text=True),
         lambda at: texts.COMPENSATION[_equipment(at)["compensation"]]),
        (Column("Drive feedback", is_text=True),
         lambda at: texts.COMPENSATION[_equipment(at)["drive_feedback"]]),
        (Column("Windows kept", brief="Kept"), lambda at: f"{at['runs_kept']} of {at['runs']}"),
        (Column("95 % interval"),
         lambda point: texts.interval_text(share_kept(point["runs_kept"], point["runs"]))),
        (Column("Lost by", is_text=True), lambda point: texts.losses_text(point) or ABSENT),
        (Column("Command, in the folder of this page", brief=None, is_text=True),
         lambda at: f"funnel-hil simulate network/scenarios/{at['worst_point']}.yaml"),
    ]  # fmt: skip
    title = f"Windows of {summary['network']} in which bounds are kept"
    note = f"Each window is {summary['duration_s']:g} s of the network, from another place in it."
    return table_of(title, columns, network["points"], note)


def _panels(sheet: DrawnSheet) -> list[Panel[DrawnSheet]]:
    panels = [
        Panel(
            "Delay", "share-kept", "Share of runs or plants that keep their bounds", _share_kept,
            "Lines: runs of the exact arm at a constant delay, and uncertain plants. Dotted: the"
            " margin for any pattern of delays. Grey: round trips of the network's worst window.",
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
              lambda _: joints.error_in_funnel(runs), "Red marks are ticks outside the funnel."),
        Panel("Worst window", "window-motion", "The arm in the worst window",
              lambda _: space.arm_motion(window.data), "Grey: where the reference wants it."),
    ]  # fmt: skip


def _share_kept(sheet: DrawnSheet) -> go.Figure:
    parts = sheet.summary["parts"]
    figure = style.new_figure(_HEIGHT_PX, "round trip (ms)", "kept (%)")
    if sheet.window is not None:
        trips_ms = np.sort(link.arrivals(sheet.window.data)[1])
        share = 100.0 * np.arange(1, len(trips_ms) + 1) / max(1, len(trips_ms))
        every = max(1, len(trips_ms) // _MOST_POINTS)
        figure.add_scatter(
            x=trips_ms[::every], y=share[::every], name="network: round trips below",
            line_color="#bbbbbb", fill="tozeroy", mode="lines",
        )  # fmt: skip
    for index, case in enumerate(parts["margin"]["cases"]):
        probes = sorted(case["probes"], key=lambda probe: float(probe["value"]))
        name, colour = texts.equipment_text(case), style.palette(index)
        figure.add_scatter(
            x=[probe["value"] for probe in probes],
            y=[100.0 * probe["runs_kept"] / probe["runs"] for probe in probes],
            name=name, mode="lines+markers", line_color=colour, line_shape="hv",
        )  # fmt: skip
        _mark(figure, f"any pattern, {name}", any_pattern_ms(case), colour, "dot")
        theory_ms = (case.get("theory") or {}).get("constant_ms")
        _mark(figure, "linear theory, constant delay", theory_ms, style.INK, "dash")
    for case in (parts.get("plants") or {"cases": ()})["cases"]:
        figure.add_scatter(
            x=[at["value"] for at in case["values"]],
            y=[100.0 * at["fraction"] for at in case["values"]],
            name="uncertain plants", mode="lines+markers", line_color=style.palette(2),
        )  # fmt: skip
    figure.update_yaxes(range=[0.0, 103.0])
    style.put_legend_on_top(figure, 1 + len(figure.data) // 3)
    return figure


def _mark(figure: go.Figure, name: str, at_ms: float | None, colour: str, dash: str) -> None:
    """Draw a margin as an upright line, with its value in the legend."""
    if at_ms is not None:
        figure.add_scatter(
            x=[at_ms, at_ms], y=[0.0, 100.0], name=f"{name}: {at_ms:g} ms", mode="lines",
            line={"color": colour, "dash": dash, "width": 1},
        )  # fmt: skip
