"""Tables and sentences of a tuning."""

from __future__ import annotations

from typing import Any

from deploy.reports.tables import Cell, Column, Status, Table, number

Summary = dict[str, Any]
AS_SAID = {"rms": "a small error with a smooth torque", "margin": "a large delay"}
BEYOND_ALL = 100.0
"""Costs of runs that count for nothing, which no figure shows."""


def tune_tables(summary: Summary) -> list[Table]:
    """Return what the search of each law found, and how its gains were judged."""
    return [_search_table(summary), *_judged_tables(summary)]


def _search_table(summary: Summary) -> Table:
    rows = [
        [law, found["cost_start"], found["cost_found"], 100.0 * found["spread"],
         "yes" if found["converged"] else "no", found.get("file")]
        for law, found in summary["laws"].items()
    ]  # fmt: skip
    return Table(
        f"{summary['name']} · gains for {AS_SAID[summary['goal']]}",
        [
            Column("Law", is_text=True),
            Column("Start", "cost"),
            Column("Found", "cost"),
            Column("Spread", "%"),
            Column("Converged", is_text=True),
            Column("Scenario", is_text=True),
        ],
        rows,
        "The smaller the cost, the better: "
        + (
            "the mean logarithm of RMS error / final bound, plus 0.25 times that of the torque's"
            " variation, plus 1 or more outside the bounds, and for a torque at its limit."
            if summary["goal"] == "rms"
            else "less 1 for each delay that is kept, and less up to 0.5 for one that is lost late."
        )
        + " Converged: the last quarter of the candidates gained less than 0.02, and the search's"
        " spread is at most half of what it was.",
    )


def _judged_tables(summary: Summary) -> list[Table]:
    """Return a table for the found gains and one for those of the start."""
    titles = {"found": "Judged with the gains found", "start": "Judged with the gains of the start"}
    places = {
        each["place"]: None
        for law in summary["laws"].values()
        for judged in law["judged"].values()
        for each in judged
    }
    if not places:
        return []
    unit = "mrad" if summary["goal"] == "rms" else "ms"
    return [
        Table(
            title,
            [Column("Law", is_text=True), *(Column(place.capitalize(), unit) for place in places)],
            [
                [law, *map(_judged_cell, found["judged"][which])]
                for law, found in summary["laws"].items()
                if which in found["judged"]
            ],
            "RMS error of the worst joint, and how many runs kept their bounds."
            if summary["goal"] == "rms"
            else "The largest of the round trips up to which every run kept its bounds.",
        )
        for which, title in titles.items()
    ]


def _judged_cell(result: Summary) -> Cell:
    status: Status = "good" if result["kept"] == result["runs"] else "bad"
    if "kept_up_to_ms" in result:
        return Cell(number(result["kept_up_to_ms"]) if result["kept_up_to_ms"] else "none")
    worst = None if result["rms_rad"] is None else 1e3 * max(result["rms_rad"])
    return Cell(f"{number(worst)}, {result['kept']} of {result['runs']}", status)


def tune_headline(summary: Summary) -> str:
    """Return the lowest cost, and how many runs the search had not seen kept their bounds."""
    law, found = min(summary["laws"].items(), key=lambda item: float(item[1]["cost_found"]))
    costs = (number(found[key]) for key in ("cost_found", "cost_start"))
    lowest = "Lowest cost: {} by {law} ({} with the gains of the start)".format(*costs, law=law)
    judged = found["judged"].get("found", ())
    kept, runs = (sum(each[key] for each in judged) for key in ("kept", "runs"))
    return lowest + (
        f"; bounds kept in {kept} of {runs} runs that were not searched" if runs else ""
    )


def tune_sentences(summary: Summary) -> list[str]:
    """Return which searches have not converged, and where to find the gains."""
    open_ = [law for law, found in summary["laws"].items() if not found["converged"]]
    sentences = []
    if open_ and summary["completed"]:
        twice = 2 * summary["budget"]
        sentences.append(
            f"Not converged: {', '.join(open_)}. The same command with --budget {twice} continues."
        )
    files = [found["file"] for found in summary["laws"].values() if "file" in found]
    return [*sentences, *([f"Scenarios with these gains: {', '.join(files)}"] if files else [])]
