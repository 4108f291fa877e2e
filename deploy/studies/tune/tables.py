"""Tables and sentences of a tuning."""

from __future__ import annotations

import math

from deploy.reports.studies.study_tables import TableColumn
from deploy.reports.tables import Cell, Column, Status, Table, number, table_of
from deploy.studies.tune.result import Judged, TuneResult

AS_SAID = {"rms": "a small error with a smooth torque", "margin": "a large delay"}
BEYOND_ALL = 100.0
"""Costs of runs that count for nothing, which no figure shows."""


def tune_tables(result: TuneResult) -> list[Table]:
    """Return what the search of each law found, and how its gains were judged."""
    return [_search_table(result), *_judged_tables(result)]


def _search_table(result: TuneResult) -> Table:
    columns: list[TableColumn] = [
        (Column("Law", is_text=True), lambda item: item[0]),
        (Column("Start", "cost"), lambda item: item[1].cost_start),
        (Column("Found", "cost"), lambda item: item[1].cost_found),
        (
            Column("Spread", "%"),
            lambda item: None if item[1].spread is None else 100.0 * item[1].spread,
        ),
        (Column("Converged", is_text=True), lambda item: "yes" if item[1].converged else "no"),
        (Column("Scenario", is_text=True), lambda item: item[1].file),
    ]
    return table_of(
        f"{result.name} · gains for {AS_SAID[result.goal]}",
        columns,
        result.laws.items(),
        "The smaller the cost, the better: "
        + (
            "the mean logarithm of RMS error / final bound, plus 0.25 times that of the torque's"
            " variation, plus 1 or more outside the bounds, and for a torque at its limit."
            if result.goal == "rms"
            else "less 1 for each delay that is kept, and less up to 0.5 for one that is lost late."
        )
        + " Converged: the last quarter of the candidates gained less than 0.02, and the search's"
        " spread is at most half of what it was.",
    )


def _judged_tables(result: TuneResult) -> list[Table]:
    """Return a table for the found gains and one for those of the start."""
    titles = {"found": "Judged with the gains found", "start": "Judged with the gains of the start"}
    judged = [each for law in result.laws.values() for own in law.judged.values() for each in own]
    places = dict.fromkeys(each.place for each in judged)
    if not places:
        return []
    unit = "mrad" if result.goal == "rms" else "ms"
    return [
        Table(
            title,
            [Column("Law", is_text=True), *(Column(place.capitalize(), unit) for place in places)],
            [
                [law, *map(_judged_cell, found.judged[which])]
                for law, found in result.laws.items()
                if which in found.judged
            ],
            "RMS error of the worst joint, and how many runs kept their bounds."
            if result.goal == "rms"
            else "The largest of the round trips up to which every run kept its bounds.",
        )
        for which, title in titles.items()
    ]


def _judged_cell(one: Judged) -> Cell:
    status: Status = "good" if one.kept == one.runs else "bad"
    if "kept_up_to_ms" in one.model_fields_set:
        return Cell(number(one.kept_up_to_ms) if one.kept_up_to_ms else "none")
    worst = None if one.rms_rad is None else 1e3 * max(one.rms_rad)
    return Cell(f"{number(worst)}, {one.kept} of {one.runs}", status)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _cost(found: float | None) -> float:
    return -math.inf if found is None else found


def tune_headline(result: TuneResult) -> str:
    """Return the lowest cost, and how many runs the search had not seen kept their bounds."""
    law, found = min(result.laws.items(), key=lambda item: _cost(item[1].cost_found))
    lowest = f"Lowest cost: {number(found.cost_found)} by {law} ({number(found.cost_start)}"
    now, before = (
        f"{sum(each.kept for each in judged)} of {sum(each.runs for each in judged)}"
        for judged in (found.judged.get(which, ()) for which in ("found", "start"))
    )
    return f"{lowest} with the gains of the start)" + (
        f"; bounds kept in {now} runs that were not searched ({before} with those of the start)"
        if found.judged.get("found") else ""
    )  # fmt: skip


def tune_sentences(result: TuneResult) -> list[str]:
    """Return which searches have not converged, and where to find the gains."""
    open_ = [law for law, found in result.laws.items() if not found.converged]
    sentences = []
    if open_ and result.completed:
        twice = 2 * result.budget
        sentences.append(
            f"Not converged: {', '.join(open_)}. The same command with --budget {twice} continues."
        )
    files = [found.file for found in result.laws.values() if found.file]
    return [*sentences, *([f"Scenarios with these gains: {', '.join(files)}"] if files else [])]
