"""Results of studies in words, and as a Markdown table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_COMPENSATION = {None: "", False: " without compensation", True: " with compensation"}


def case_name(case: dict[str, Any]) -> str:
    """What a margin is of: the law, and whether with compensation."""
    return f"{case['law']}{_COMPENSATION[case['compensation']]}"


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


def held_again(summary: dict[str, Any]) -> list[str]:
    """A sentence for each case that kept its bounds once more beyond its first failure."""
    return [
        f"{case['arm']}, {case_name(case)}: held again at"
        f" {', '.join(f'{value:g}' for value in case['held_again'])}, beyond its first failure."
        for case in summary["cases"]
        if case["held_again"]
    ]


def write_margin_table(summary: dict[str, Any], path: Path) -> None:
    """Write margins as a Markdown table: a row per law, a column per arm and compensation."""
    path.write_text(margin_table(summary) + "\n", encoding="utf-8")


def margin_table(summary: dict[str, Any]) -> str:
    """Margins as a Markdown table: a row per law, a column per arm and compensation."""
    columns = list(dict.fromkeys((case["arm"], case["compensation"]) for case in summary["cases"]))
    cells = {
        (case["law"], case["arm"], case["compensation"]): margin_text(case, summary)
        for case in summary["cases"]
    }
    header = ["law", *(f"{arm}{_COMPENSATION[on].replace(' ', ', ', 1)}" for arm, on in columns)]
    laws = dict.fromkeys(case["law"] for case in summary["cases"])
    body = [[f"`{law}`", *(cells[law, arm, on] for arm, on in columns)] for law in laws]
    lines = [header, ["---"] * len(header), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
