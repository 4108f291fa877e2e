"""Results of sweeps and margins in words and as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.studies.robustness_tables import interval_text, share_text
from deploy.reports.studies.study_text import (
    CaseText,
    case_name,
    ceiling_text,
    optional_columns,
    setting_text,
)
from deploy.reports.tables import ABSENT, Column, Table, Value, quotable, scaled


def shown_value(value: Any) -> str:
    """A swept value; whole numbers without a decimal point."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def margin_figure(case: dict[str, Any]) -> str:
    """A margin without its unit; that it is beyond the limit, or that there is none."""
    if not case["completed"]:
        return "not known yet"
    if case["margin"] is None:
        return "none"
    beyond = "≥ " if case["growth"] > 0 else "≤ "
    sign = beyond if case["first_failure"] is None else ""
    return f"{sign}{case['margin']:g}"


def margin_text(case: dict[str, Any], summary: dict[str, Any]) -> str:
    """A margin with its unit."""
    has_unit = case["completed"] and case["margin"] is not None
    return f"{margin_figure(case)} {summary['unit'] if has_unit else ''}".rstrip()


def _with_unit(value: float | None, summary: dict[str, Any]) -> str | None:
    return None if value is None else f"{value:g} {summary['unit']}".rstrip()


def probe_at(case: dict[str, Any], value: float | None) -> dict[str, Any] | None:
    """What became of a value that was tried."""
    return next((probe for probe in case["probes"] if probe["value"] == value), None)


def held_again(summary: dict[str, Any]) -> list[str]:
    """A sentence for each case that kept its bounds once more beyond its first failure."""
    return [
        f"{case['arm']}, {case_name(case)}: held again at"
        f" {', '.join(f'{value:g}' for value in case['held_again'])}, beyond its first failure."
        for case in summary["cases"]
        if case["held_again"]
    ]


def furthest(summary: dict[str, Any]) -> str:
    """What a margin is of the values that held: the largest, or where values shrink the least."""
    return "smallest" if any(case["growth"] < 0 for case in summary["cases"]) else "largest"


def margin_table(summary: dict[str, Any]) -> Table:
    """Margins, a row for each law on each arm."""
    more = optional_columns(summary)
    return Table(
        f"{summary['name']} · {furthest(summary)} {summary['title']} at which the bounds are kept",
        [
            Column("Arm", is_text=True),
            Column("Law", is_text=True),
            *(column for column, _ in more),
            Column("Margin", brief="Held"),
            *(Column(f"On {physics}", summary["unit"]) for physics in _elsewhere(summary)),
            Column("First failure", brief="First\nfailure"),
            Column("Ticks outside at first failure", "%", "Outside\nthere"),
            Column("RMS error of the worst joint at the margin", "mrad", None),
            Column("Held again at", brief=None),
        ],
        [_margin_row(case, summary, [text for _, text in more]) for case in summary["cases"]],
        "A value holds if the bounds are kept from every start with every seed; the margin is the"
        f" {furthest(summary)} value up to which all that were probed held. Held-arm ceiling: until"
        " the first command acts the brakes hold the arm, and from the worst start its error leaves"
        " the funnel after this time; no law can start under a longer delay.",
    )


def _elsewhere(summary: dict[str, Any]) -> list[str]:
    """Other physics on which margins were confirmed."""
    return list(dict.fromkeys(on for case in summary["cases"] for on in case.get("margin_on", ())))


def _margin_row(
    case: dict[str, Any],
    summary: dict[str, Any],
    more: list[CaseText],
) -> list[Value]:
    failed, last = probe_at(case, case["first_failure"]), probe_at(case, case["margin"])
    return [
        case["arm"], case["law"],
        *(text(case) for text in more),
        margin_text(case, summary),
        *(case["margin_on"].get(physics) for physics in _elsewhere(summary)),
        _with_unit(case["first_failure"], summary),
        scaled(failed["violation_fraction"]["mean"], 100.0) if failed else None,
        scaled(last["worst_rms_rad"]["mean"], 1e3) if last else None,
        ", ".join(f"{value:g}" for value in case["held_again"]) or ABSENT,
    ]  # fmt: skip


def point_table(summary: dict[str, Any]) -> Table:
    """The points of a sweep, a row each."""
    axes = [", ".join(axis["keys"]) for axis in summary["axes"]]
    of_plants = summary["plants"] is not None
    plants = [Column("Plants kept", brief="Plants\nkept"), Column("Wilson's 95 % interval")]
    return Table(
        f"{summary['name']} · {summary['scenario']}",
        [
            Column("Point", brief=None, is_text=True),
            *(Column(keys, brief=keys.replace(", ", "\n").replace(".", ".\n")) for keys in axes),
            *(plants if of_plants else ()),
            Column("Runs that kept their bounds", brief="Bounds\nkept"),
            Column("Ticks outside", "%", "Outside"),
            Column("Ticks outside in the worst run", "%", None),
            Column("RMS error of the worst joint", "mrad", "Worst\nRMS"),
            Column("Failed runs", brief="Failed"),
        ],
        [
            [
                point["point"], *map(shown_value, point["values"]),
                *((share_text(point), interval_text(point)) if of_plants else ()),
                f"{point['runs_kept']} of {point['runs']}",
                scaled(point["violation_fraction"]["mean"], 100.0),
                scaled(point["violation_fraction"]["highest"], 100.0),
                scaled(point["worst_rms_rad"]["mean"], 1e3),
                point["runs_failed"],
            ]
            for point in summary["points"]
        ],
        "Means over the seeds and plants of a point; the worst run is the one with the most ticks"
        " outside.",
    )  # fmt: skip


def margins_by_law(summary: dict[str, Any]) -> Table:
    """Margins for documents: a row per law, a column per arm and setting; and the ceilings."""
    columns = {(case["arm"], setting_text(case)): case for case in summary["cases"]}
    margins = {
        (case["law"], case["arm"], setting_text(case)): margin_text(case, summary)
        for case in summary["cases"]
    }
    headings = [f"{arm}, {setting}" if setting else arm for arm, setting in columns]
    laws = dict.fromkeys(case["law"] for case in summary["cases"])
    rows = [[f"`{law}`", *(margins[law, *column] for column in columns)] for law in laws]
    ceilings = [ceiling_text(case) for case in columns.values()]
    if any(ceilings):
        rows.append(["held-arm ceiling", *(ceiling or ABSENT for ceiling in ceilings)])
    return Table(
        f"{summary['name']} · {furthest(summary)} {summary['title']} at which the bounds are kept",
        list(map(Column, ("law", *headings))),
        rows,
    )


def write_margin_table(summary: dict[str, Any], path: Path) -> None:
    """Write margins as a Markdown table: a row per law, a column per arm and compensation."""
    write_whole(path, quotable(margins_by_law(summary), summary.get("conditions", {})))
