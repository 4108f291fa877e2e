"""Report of a benchmark: laws and predictors by their worst arm, and each arm by itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

import plotly.graph_objects as go

from deploy.reports.figures import style
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.study_result import Share
from deploy.reports.studies.study_tables import TableColumn, shown_columns
from deploy.reports.studies.study_texts import listed, remedy_text
from deploy.reports.tables import Cell, Column, Status, Table, scaled, table_of
from deploy.studies.benchmark.result import BenchmarkResult, CellResult
from deploy.study.study import rows_by

Cells = list[CellResult]
_HEIGHT_PX = 430
_DASHES = ("solid", "dash", "dot")
_SYMBOLS = ("circle", "diamond", "square", "cross", "x")


def benchmark_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """Return the report of a benchmark."""
    result = BenchmarkResult.model_validate(study.summary)
    entries = _ranked(result)
    first = _first_sentence(result, entries)
    headline, reasons = (first, []) if result.completed else ("not complete", [first])
    predictors = result.names("predictor")
    predictors.sort(key=lambda predictor: predictor != entries[0][0].predictor)  # the best leads
    limits = (
        "The delays are a grid, so that a margin is at least the value shown. RMS error and travel"
        f" are those at {result.delays_ms[0]:g} ms."
    )
    return Page(
        "benchmark",
        result.name,
        verdict=ReportHead(
            "mixed", headline.rstrip("."), [*reasons, *_lost_at_once(result), limits]
        ),
        facts=[
            Fact("Arms", str(len(result.names("scenario")))),
            Fact("Uncertain plants", str(result.plants or "none")),
        ],
        panels=lambda: [
            *(_kept_panel(result, each, "Delay" if place else "First")
              for place, each in enumerate(predictors)),
            _scatter_panel(result),
        ],
        subject=study,
        results=[Cards([_ranking(result, entries), _by_arm(result)], "stacked")],
    )  # fmt: skip


def _first_sentence(result: BenchmarkResult, entries: list[Cells]) -> str:
    if not result.completed:
        return (
            f"{result.runs} of about {result.runs_expected} runs: margins, shares and ranks"
            " are those so far, and may change."
        )
    cells = entries[0]
    law, predictor, gains = cells[0].entry
    kept_ms = _least(cells)
    if not kept_ms:
        return f"No law with any predictor kept {result.delays_ms[0]:g} ms on every arm."
    others = sum(len(each) == len(cells) and _least(each) == kept_ms for each in entries[1:])
    return (
        f"Largest delay that every arm and pattern kept: {kept_ms:g} ms, by {law} with predictor"
        f" {predictor} and {gains} gains" + f"; {others} more kept as much" * bool(others) + "."
    )


def _ranked(result: BenchmarkResult) -> list[Cells]:
    """Return the cells of all arms by entry: by the worst arm, the mean, then the error.

    Entries without a cell of every arm, such as gains tuned on one, come last: their worst arm may
    be one that they have not run.
    """

    def rank(cells: Cells) -> tuple[float, ...]:
        any_ms = [cell.any_pattern_ms for cell in cells]
        return (
            -len(cells), -min(any_ms), -sum(any_ms) / len(cells), -_mean_ms(cells),
            _worst_rms_rad(cells),
        )  # fmt: skip

    return sorted(rows_by(result.cells, lambda cell: cell.entry).values(), key=rank)


def _lost_at_once(result: BenchmarkResult) -> list[str]:
    """Name what helps each law that is lost at the smallest delay, where that is known."""
    arms: dict[tuple[str, str], list[str]] = {}
    laws = {cell.law for cell in result.cells}
    for cell in result.cells:
        remedy = None if cell.margin_ms else remedy_text(cell.losses, cell.law, laws)
        if remedy:
            arms.setdefault((cell.law, remedy), []).append(cell.scenario)
    return [
        f"{law} is lost already at {result.delays_ms[0]:g} ms on"
        f" {listed([*dict.fromkeys(names)])}: {remedy}."
        for (law, remedy), names in arms.items()
    ]


def _least(cells: Cells) -> float:
    return min(cell.any_pattern_ms for cell in cells)


def _mean_ms(cells: Cells) -> float:
    return sum(cell.margin_ms for cell in cells) / len(cells)


def _worst_rms_rad(cells: Cells) -> float:
    """Return the error of the worst joint of the worst arm; infinite if one is unknown."""
    errors = (cell.worst_rms_rad for cell in cells)
    return max(math.inf if each is None else each for each in errors)


def _entry_columns() -> list[TableColumn]:
    def column(name: str) -> TableColumn:
        return Column(name.capitalize(), is_text=True), lambda cell: getattr(cell, name)

    return list(map(column, ("law", "predictor", "gains")))


def _ranking(result: BenchmarkResult, entries: list[Cells]) -> Table:
    arms = len(result.names("scenario"))
    is_uneven = any(len(cells) < arms for cells in entries)

    def rms_mrad(cells: Cells) -> float | None:
        rms_rad = _worst_rms_rad(cells)
        return 1e3 * rms_rad if math.isfinite(rms_rad) else None

    columns: list[TableColumn] = [
        *((column, lambda cells, of=of: of(cells[0])) for column, of in _entry_columns()),
        (Column("Any pattern, worst arm", "ms"), _least),
        (Column("Constant, worst arm", "ms"), lambda cells: min(c.margin_ms for c in cells)),
        (Column("Constant, mean", "ms"), _mean_ms),
        (Column("RMS error, worst arm", "mrad"), rms_mrad),
        *([(Column("Arms", is_text=True), lambda cells: f"{len(cells)} of {arms}")] * is_uneven),
        *([(Column("Windows kept", is_text=True),
            lambda cells: _share([e for cell in cells for e in cell.networks.values()]))]
          if result.networks else []),
        *([(Column("Plants kept", is_text=True),
            lambda cells: _share([each for cell in cells for each in cell.plants_kept]))]
          if result.plants else []),
    ]  # fmt: skip
    return table_of(
        f"{result.name} · by the worst arm, then the mean", columns, entries,
        "A law that is lost at the smallest delay has no further runs: 0 ms, and windows and plants"
        " of its other arms only. Plants: over all delays that were asked for."
        + " Rows without every arm come last." * is_uneven,
    )  # fmt: skip


def _share(shares: Sequence[Share]) -> Cell:
    kept, total = sum(each.kept for each in shares), sum(each.total for each in shares)
    status: Status = "good" if total and kept == total else "bad"
    return Cell(f"{kept} of {total}", status) if total else Cell("none run")


def _by_arm(result: BenchmarkResult) -> Table:
    def of_network(name: str) -> TableColumn:
        return Column(name, "%"), lambda cell: scaled(cell.fraction(name), 100.0)

    columns: list[TableColumn] = [
        (Column("Arm", is_text=True), lambda cell: cell.scenario),
        *_entry_columns(),
        *shown_columns(CellResult),
        (Column("RMS error", "mrad"), lambda cell: scaled(cell.worst_rms_rad, 1e3)),
        (Column("Travel", "N m/s"), lambda cell: cell.worst_travel_nm_per_s),
        *map(of_network, result.networks),
    ]
    note = "Share of the windows of each network that were kept." if result.networks else ""
    return table_of("Each arm", columns, result.cells, note)


def _kept_panel(result: BenchmarkResult, predictor: str, section: str) -> Panel[DrawnStudy]:
    return Panel(
        section, f"benchmark-{predictor}", f"Cases that are kept, predictor {predictor}",
        lambda _: _kept(result, predictor),
        "Share of arms and uncertain plants that keep their bounds up to a constant delay, with the"
        " better of given and tuned gains; plants of an arm that is lost itself count as lost.",
    )  # fmt: skip


def _kept(result: BenchmarkResult, predictor: str) -> go.Figure:
    figure = style.new_figure(_HEIGHT_PX, "round trip (ms)", "kept (%)")
    delays_ms, arms = result.delays_ms, len(result.names("scenario"))
    for index, law in enumerate(result.names("law")):
        curves = []
        for gains in result.names("gains"):
            cells = [cell for cell in result.cells if cell.entry == (law, predictor, gains)]
            if len(cells) == arms:
                plants = result.plants or 0
                curves.append([_share_at(cells, delay_ms, plants) for delay_ms in delays_ms])
        if curves:
            figure.add_scatter(
                x=delays_ms, y=max(curves, key=sum), name=law, mode="lines+markers",
                line={"color": style.palette(index), "dash": _DASHES[index // 7 % len(_DASHES)]},
            )  # fmt: skip
    style.put_legend_on_top(figure, 1 + len(figure.data) // 4)
    return figure


def _share_at(cells: Cells, delay_ms: float, plants_of_arm: int) -> float:
    """Return the share of all arms, and of their plants, that are kept at a delay, in %."""
    kept = sum(cell.margin_ms >= delay_ms for cell in cells)
    plants = [each for cell in cells for each in cell.plants_kept if each.round_trip_ms == delay_ms]
    total = len(cells) * (1 + plants_of_arm)
    return float(100.0 * (kept + sum(each.kept for each in plants)) / total)


def _margin_and_error(result: BenchmarkResult) -> go.Figure:
    figure = style.new_figure(_HEIGHT_PX, "RMS error (mrad)", "constant delay kept (ms)")
    figure.update_xaxes(type="log")
    predictors = result.names("predictor")
    for index, law in enumerate(result.names("law")):
        cells = [
            cell for cell in result.cells
            if cell.law == law and cell.worst_rms_rad is not None and cell.margin_ms
        ]  # fmt: skip
        figure.add_scatter(
            x=[scaled(cell.worst_rms_rad, 1e3) for cell in cells],
            y=[cell.margin_ms for cell in cells], name=law, mode="markers",
            marker={
                "color": style.palette(index),
                "symbol": [
                    _SYMBOLS[predictors.index(cell.predictor) % len(_SYMBOLS)] for cell in cells
                ],
            },
            text=[f"{c.scenario}, {c.predictor}, {c.gains} gains" for c in cells],
        )  # fmt: skip
    for symbol, predictor in zip(_SYMBOLS, predictors if len(predictors) > 1 else (), strict=False):
        marker = {"color": style.MUTED, "symbol": symbol}
        figure.add_scatter(x=[None], y=[None], name=predictor, mode="markers", marker=marker)
    style.put_legend_on_top(figure, 1 + len(figure.data) // 4)
    return figure


def _scatter_panel(result: BenchmarkResult) -> Panel[DrawnStudy]:
    return Panel(
        "Delay", "benchmark-scatter", "Delay against precision",
        lambda _: _margin_and_error(result),
        "A point for each arm, predictor and gains that keep the smallest delay: further to the"
        " left is more precise there, higher is more robust. Colours: laws; symbols: predictors.",
    )  # fmt: skip
