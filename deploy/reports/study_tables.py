"""Results of sweeps and margins in words and as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deploy.reports.tables import ABSENT, Column, Table, as_markdown, scaled

_COMPENSATION = {None: "", False: "without", True: "with"}


def case_name(case: dict[str, Any]) -> str:
    """What a margin is of: the law, and whether with compensation."""
    compensation = _COMPENSATION[case["compensation"]]
    return f"{case['law']} {compensation} compensation" if compensation else str(case["law"])


def shown_value(value: Any) -> str:
    """A swept value; whole numbers without a decimal point."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def margin_figure(case: dict[str, Any]) -> str:
    """A margin without its unit; that it is beyond the limit, or that there is none."""
    if not case["completed"]:
        return "not known yet"
    if case["margin"] is None:
        return "none"
    sign = "≥ " if case["first_failure"] is None else ""
    return f"{sign}{case['margin']:g}"


def margin_text(case: dict[str, Any], summary: dict[str, Any]) -> str:
    """A margin with its unit."""
    has_unit = case["completed"] and case["margin"] is not None
    return f"{margin_figure(case)} {summary['unit'] if has_unit else ''}".rstrip()


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


def margin_table(summary: dict[str, Any]) -> Table:
    """Margins, a row for each law on each arm."""
    rows = []
    for case in summary["cases"]:
        failed, last = probe_at(case, case["first_failure"]), probe_at(case, case["margin"])
        rows.append([
            case["arm"], case["law"], _COMPENSATION[case["compensation"]],
            margin_text(case, summary), case["first_failure"],
            scaled(failed["violation_fraction"]["mean"], 100.0) if failed else None,
            scaled(last["worst_rms_rad"]["mean"], 1e3) if last else None,
            ", ".join(f"{value:g}" for value in case["held_again"]) or ABSENT,
        ])  # fmt: skip
    return Table(
        f"{summary['name']} · largest {summary['title']} at which the bounds are kept",
        [
            Column("Arm", is_text=True),
            Column("Law", is_text=True),
            Column("Compensation", brief="Compen-\nsation", is_text=True),
            Column("Margin", brief="Held"),
            Column("First failure", brief="First\nfailure"),
            Column("Ticks outside at first failure", "%", "Outside\nthere"),
            Column("RMS error of the worst joint at the margin", "mrad", None),
            Column("Held again at", brief=None),
        ],
        rows,
        "A value holds if the bounds are kept from every start with every seed; the margin is the"
        " largest value up to which all that were probed held.",
    )


def point_table(summary: dict[str, Any]) -> Table:
    """The points of a sweep, a row each."""
    axes = [", ".join(axis["keys"]) for axis in summary["axes"]]
    return Table(
        f"{summary['name']} · {summary['scenario']}",
        [
            Column("Point", brief=None, is_text=True),
            *(Column(keys, brief=keys.replace(", ", "\n").replace(".", ".\n")) for keys in axes),
            Column("Runs that kept their bounds", brief="Bounds\nkept"),
            Column("Ticks outside", "%", "Outside"),
            Column("Ticks outside in the worst run", "%", None),
            Column("RMS error of the worst joint", "mrad", "Worst\nRMS"),
            Column("Failed runs", brief="Failed"),
        ],
        [
            [
                point["point"], *map(shown_value, point["values"]),
                f"{point['runs_kept']} of {point['runs']}",
                scaled(point["violation_fraction"]["mean"], 100.0),
                scaled(point["violation_fraction"]["highest"], 100.0),
                scaled(point["worst_rms_rad"]["mean"], 1e3),
                point["runs_failed"],
            ]
            for point in summary["points"]
        ],
        "Means over the seeds of a point; the worst run is the one with the most ticks outside.",
    )  # fmt: skip


def margins_by_law(summary: dict[str, Any]) -> Table:
    """Margins for documents: a row per law, a column per arm and compensation."""
    columns = list(dict.fromkeys((case["arm"], case["compensation"]) for case in summary["cases"]))
    margins = {
        (case["law"], case["arm"], case["compensation"]): margin_text(case, summary)
        for case in summary["cases"]
    }
    headings = [
        arm if on is None else f"{arm}, {_COMPENSATION[on]} compensation" for arm, on in columns
    ]
    laws = dict.fromkeys(case["law"] for case in summary["cases"])
    rows = [[f"`{law}`", *(margins[law, arm, on] for arm, on in columns)] for law in laws]
    return Table("Margins", list(map(Column, ("law", *headings))), rows)


def write_margin_table(summary: dict[str, Any], path: Path) -> None:
    """Write margins as a Markdown table: a row per law, a column per arm and compensation."""
    path.write_text(as_markdown(margins_by_law(summary)) + "\n", encoding="utf-8")
