"""Report of a benchmark: laws and predictors by their worst arm, and each arm by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.tables import Cell, Column, Status, Table
from deploy.study.statistics import worst

Summary = Mapping[str, Any]
Entry = tuple[str, str, str]
"""Law, predictor, and whether its gains are given or tuned."""
_HEIGHT_PX = 430
_DASHES = ("solid", "dash", "dot")
_SYMBOLS = ("circle", "diamond", "square", "cross", "x")


def benchmark_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """Return the report of a benchmark."""
    summary = study.summary
    entries = _ranked(summary)
    first = _first_sentence(summary, entries)
    headline, reasons = (first, []) if summary["completed"] else ("not complete", [first])
    predictors = _names(summary, "predictor")
    predictors.sort(key=lambda predictor: predictor != entries[0][0][1])  # that of the best leads
    limits = (
        "The delays are a grid, so that a margin is at least the value shown. RMS error and travel"
        f" are those at {summary['delays_ms'][0]:g} ms."
    )
    return Page(
        "benchmark",
        summary["name"],
        verdict=ReportHead("mixed", headline.rstrip("."), [*reasons, limits]),
        facts=[
            Fact("Arms", str(len(_names(summary, "scenario")))),
            Fact("Uncertain plants", str(summary["plants"] or "none")),
        ],
        panels=lambda: [
            *(_kept_panel(each, "Delay" if place else "First")
              for place, each in enumerate(predictors)),
            _SCATTER,
        ],
        subject=study,
        results=[Cards([_ranking(summary, entries), _by_arm(summary)], "stacked")],
    )  # fmt: skip


def _first_sentence(summary: Summary, entries: list[tuple[Entry, list[Summary]]]) -> str:
    if not summary["completed"]:
        return (
            f"{summary['runs']} of about {summary['runs_expected']} runs: margins, shares and ranks"
            " are those so far, and may change."
        )
    (law, predictor, gains), cells = entries[0]
    kept_ms = _least(cells, "any_pattern_ms")
    if not kept_ms:
        return f"No law with any predictor kept {summary['delays_ms'][0]:g} ms on every arm."
    alike = [each for _, each in entries[1:] if len(each) == len(cells)]
    others = sum(_least(each, "any_pattern_ms") == kept_ms for each in alike)
    return (
        f"Largest delay that every arm and pattern kept: {kept_ms:g} ms, by {law} with predictor"
        f" {predictor} and {gains} gains" + f"; {others} more kept as much" * bool(others) + "."
    )


def _names(summary: Summary, key: str) -> list[str]:
    return list(dict.fromkeys(cell[key] for cell in summary["cells"]))


def _ranked(summary: Summary) -> list[tuple[Entry, list[Summary]]]:
    """Return the cells of all arms by entry: by the worst arm, the mean, then the error.

    Entries without a cell of every arm, such as gains tuned on one, come last: their worst arm may
    be one that they have not run.
    """
    found: dict[Entry, list[Summary]] = {}
    for cell in summary["cells"]:
        found.setdefault((cell["law"], cell["predictor"], cell["gains"]), []).append(cell)

    def rank(item: tuple[Entry, list[Summary]]) -> tuple[float, ...]:
        cells = item[1]
        return (
            -len(cells), -_least(cells, "any_pattern_ms"), -_mean(cells, "any_pattern_ms"),
            -_mean(cells, "margin_ms"), _worst_rms_rad(cells),
        )  # fmt: skip

    return sorted(found.items(), key=rank)


def _least(cells: list[Summary], key: str) -> float:
    return min(float(cell[key]) for cell in cells)


def _worst_rms_rad(cells: list[Summary]) -> float:
    """Return the error of the worst joint of the worst arm; infinite if one is unknown."""
    errors = [worst(cell["rms_rad"]) for cell in cells]
    return max(math.inf if each is None else each for each in errors)


def _mean(cells: list[Summary], key: str) -> float:
    return sum(float(cell[key]) for cell in cells) / len(cells)


def _ranking(summary: Summary, entries: list[tuple[Entry, list[Summary]]]) -> Table:
    columns = [
        *(Column(name, is_text=True) for name in ("Law", "Predictor", "Gains")),
        Column("Any pattern, worst arm", "ms"), Column("Constant, worst arm", "ms"),
        Column("Constant, mean", "ms"), Column("RMS error, worst arm", "mrad"),
    ]  # fmt: skip
    arms = len(_names(summary, "scenario"))
    is_uneven = any(len(cells) < arms for _, cells in entries)
    if is_uneven:
        columns.append(Column("Arms", is_text=True))
    if summary["networks"]:
        columns.append(Column("Windows kept", is_text=True))
    if summary["plants"]:
        columns.append(Column("Plants kept", is_text=True))
    rows = []
    for entry, cells in entries:
        rms_rad = _worst_rms_rad(cells)
        row: list[Any] = [
            *entry, _least(cells, "any_pattern_ms"), _least(cells, "margin_ms"),
            _mean(cells, "margin_ms"),
            1e3 * rms_rad if math.isfinite(rms_rad) else None,
        ]  # fmt: skip
        if is_uneven:
            row.append(f"{len(cells)} of {arms}")
        if summary["networks"]:
            row.append(_share([each for cell in cells for each in cell["networks"].values()]))
        if summary["plants"]:
            row.append(_share([each for cell in cells for each in cell["plants_kept"]]))
        rows.append(row)
    return Table(
        f"{summary['name']} · by the worst arm, then the mean", columns, rows,
        "A law that is lost at the smallest delay has no further runs: 0 ms, and windows and plants"
        " of its other arms only. Plants: over all delays that were asked for."
        + " Rows without every arm come last." * is_uneven,
    )  # fmt: skip


def _share(shares: list[Summary]) -> Cell:
    kept, total = (sum(each[key] for each in shares) for key in ("kept", "total"))
    status: Status = "good" if total and kept == total else "bad"
    return Cell(f"{kept} of {total}", status) if total else Cell("none run")


def _by_arm(summary: Summary) -> Table:
    rows = [
        [
            cell["scenario"], cell["law"], cell["predictor"], cell["gains"], cell["margin_ms"],
            cell["any_pattern_ms"],
            *(None if value is None else factor * value for value, factor in (
                (worst(cell["rms_rad"]), 1e3), (worst(cell["travel_nm_per_s"]), 1.0))),
            *(_network(cell, name) for name in summary["networks"]),
        ]
        for cell in summary["cells"]
    ]  # fmt: skip
    columns = [
        *(Column(name, is_text=True) for name in ("Arm", "Law", "Predictor", "Gains")),
        Column("Constant", "ms"), Column("Any pattern", "ms"), Column("RMS error", "mrad"),
        Column("Travel", "N m/s"),
        *(Column(name, "%") for name in summary["networks"]),
    ]  # fmt: skip
    note = "Share of the windows of each network that were kept." if summary["networks"] else ""
    return Table("Each arm", columns, rows, note)


def _network(cell: Summary, name: str) -> float | None:
    share = cell["networks"].get(name)
    return None if share is None else 100.0 * share["fraction"]


def _kept_panel(predictor: str, section: str) -> Panel[DrawnStudy]:
    return Panel(
        section, f"benchmark-{predictor}", f"Cases that are kept, predictor {predictor}",
        partial(_kept, predictor),
        "Share of arms and uncertain plants that keep their bounds up to a constant delay, with the"
        " better of given and tuned gains; plants of an arm that is lost itself count as lost.",
    )  # fmt: skip


def _kept(predictor: str, study: DrawnStudy) -> go.Figure:
    summary = study.summary
    figure = style.new_figure(_HEIGHT_PX, "round trip (ms)", "kept (%)")
    delays_ms, arms = summary["delays_ms"], len(_names(summary, "scenario"))
    for index, law in enumerate(_names(summary, "law")):
        curves = []
        for gains in _names(summary, "gains"):
            cells = [
                cell for cell in summary["cells"]
                if (cell["law"], cell["predictor"], cell["gains"]) == (law, predictor, gains)
            ]  # fmt: skip
            if len(cells) == arms:
                plants = summary["plants"] or 0
                curves.append([_share_at(cells, delay_ms, plants) for delay_ms in delays_ms])
        if curves:
            figure.add_scatter(
                x=delays_ms, y=max(curves, key=sum), name=law, mode="lines+markers",
                line={"color": style.palette(index), "dash": _DASHES[index // 7 % len(_DASHES)]},
            )  # fmt: skip
    style.put_legend_on_top(figure, 1 + len(figure.data) // 4)
    return figure


def _share_at(cells: list[Summary], delay_ms: float, plants_of_arm: int) -> float:
    """Return the share of all arms, and of their plants, that are kept at a delay, in %."""
    kept = sum(cell["margin_ms"] >= delay_ms for cell in cells)
    plants = [
        each for cell in cells for each in cell["plants_kept"] if each["round_trip_ms"] == delay_ms
    ]
    total = len(cells) * (1 + plants_of_arm)
    return float(100.0 * (kept + sum(each["kept"] for each in plants)) / total)


def _margin_and_error(study: DrawnStudy) -> go.Figure:
    summary = study.summary
    figure = style.new_figure(_HEIGHT_PX, "RMS error (mrad)", "constant delay kept (ms)")
    figure.update_xaxes(type="log")
    predictors = _names(summary, "predictor")
    for index, law in enumerate(_names(summary, "law")):
        cells = [
            cell for cell in summary["cells"]
            if cell["law"] == law and worst(cell["rms_rad"]) is not None and cell["margin_ms"]
        ]  # fmt: skip
        figure.add_scatter(
            x=[1e3 * (worst(cell["rms_rad"]) or 0.0) for cell in cells],
            y=[cell["margin_ms"] for cell in cells], name=law, mode="markers",
            marker={
                "color": style.palette(index),
                "symbol": [
                    _SYMBOLS[predictors.index(cell["predictor"]) % len(_SYMBOLS)] for cell in cells
                ],
            },
            text=[f"{c['scenario']}, {c['predictor']}, {c['gains']} gains" for c in cells],
        )  # fmt: skip
    for symbol, predictor in zip(_SYMBOLS, predictors if len(predictors) > 1 else (), strict=False):
        marker = {"color": style.MUTED, "symbol": symbol}
        figure.add_scatter(x=[None], y=[None], name=predictor, mode="markers", marker=marker)
    style.put_legend_on_top(figure, 1 + len(figure.data) // 4)
    return figure


_SCATTER: Panel[DrawnStudy] = Panel(
    "Delay", "benchmark-scatter", "Delay against precision", _margin_and_error,
    "A point for each arm, predictor and gains that keep the smallest delay: further to the left is"
    " more precise there, higher is more robust. Colours: laws; symbols: predictors.",
)  # fmt: skip
