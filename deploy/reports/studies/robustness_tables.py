"""Results over uncertain plants in words and as tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.studies.study_text import case_name, optional_columns
from deploy.reports.tables import ABSENT, Column, Table, Value, quotable

_SHOWN_EFFECTS = 6


def value_text(value: float, summary: dict[str, Any]) -> str:
    """A value with its unit."""
    return f"{value:g} {summary['unit']}".rstrip()


def interval_text(share: dict[str, Any]) -> str:
    """Wilson's interval of a share in per cent."""
    if share["wilson_95"] is None:
        return ABSENT
    low, high = (100 * end for end in share["wilson_95"])
    return f"{low:.0f}–{high:.0f} %"


def share_text(share: dict[str, Any]) -> str:
    """How many of how many were kept."""
    return f"{share['kept']} of {share['total']}" if share["total"] else ABSENT


def kept_text(case: dict[str, Any], summary: dict[str, Any]) -> str:
    """Up to where enough plants are kept."""
    if case["kept_up_to"] is None:
        is_judged = case["values"][0]["total"] == summary["plants"]
        return "none" if is_judged else "not known yet"
    return value_text(case["kept_up_to"], summary)


def _count(share: dict[str, Any], summary: dict[str, Any]) -> str:
    """How many were kept; of how many where not all are judged yet."""
    return str(share["kept"]) if share["total"] == summary["plants"] else share_text(share)


def robustness_table(summary: dict[str, Any]) -> Table:
    """How many plants were kept at each value, a row for each case."""
    share, more = f"{100 * summary['kept_share']:g} %", optional_columns(summary)
    by = f"{summary['title']} ({summary['unit']})" if summary["unit"] else summary["title"]
    return Table(
        f"{summary['name']} · of {summary['plants']} plants, kept their bounds, by {by}",
        [
            Column("Arm", is_text=True),
            Column("Law", is_text=True),
            *(column for column, _ in more),
            Column(f"{share} kept up to", brief=f"{share}\nup to"),
            *(Column(f"{value:g}") for value in summary["values"]),
        ],
        [
            [
                case["arm"], case["law"],
                *(text(case) for _, text in more), kept_text(case, summary),
                *(_count(value, summary) for value in case["values"]),
            ]
            for case in summary["cases"]
        ],
        f"Plants 1 to {summary['plants']} of plant_seed {summary['plant_seed']}, the same in every"
        " cell. A plant is kept if it is with every seed. The held-arm ceiling is that of the plant"
        " that has the least: no law can start it under a longer delay.",
    )  # fmt: skip


def interval_table(summary: dict[str, Any]) -> Table:
    """The shares with their intervals, a row for each case and value."""
    return Table(
        "Shares with their uncertainty",
        [
            Column("Case", is_text=True),
            Column(summary["title"], summary["unit"]),
            Column("Kept"),
            Column("Wilson's 95 % interval"),
            Column("Cannot start: beyond their held-arm ceiling"),
        ],
        [
            [
                f"{case['arm']}, {case_name(case)}", value["value"], share_text(value),
                interval_text(value), float(value["beyond_held_arm_ceiling"]),
            ]
            for case in summary["cases"]
            for value in case["values"]
        ],
        "The interval says how far the share of all plants that could be drawn may lie from that of"
        " those that were.",
    )  # fmt: skip


def losses_table(summary: dict[str, Any]) -> Table:
    """What lost plants have in common, the strongest first."""
    rows: list[list[Value]] = []
    for case in summary["cases"]:
        losses, name = case["losses"], f"{case['arm']}, {case_name(case)}"
        counts = f"{losses['lost_plants']} / {losses['kept_plants']}"
        if losses["effects"] is None:
            rows.append([name, "too few lost or kept to say", None, None, counts])
            continue
        first, *others = losses["effects"][:_SHOWN_EFFECTS]
        rows.append([name, first["quantity"], _effect(first), losses["chance_level"], counts])
        rows += [["", one["quantity"], _effect(one), "", ""] for one in others]
    return Table(
        "What lost plants have in common",
        [
            Column("Case", is_text=True),
            Column("Drawn quantity", is_text=True),
            Column("Effect"),
            Column("Chance level", brief="Chance"),
            Column("Plants lost / kept", brief="Lost /\nkept"),
        ],
        rows,
        "Effect: rank-biserial correlation, +1 where every lost plant had more of it than every"
        " kept one, −1 where less, 0 where it makes no difference; all values at which some were"
        " lost and some kept count together. The strongest of so many effects exceeds the chance"
        " level in 5 % of shuffles though nothing matters: what lies below it says nothing, what"
        " lies above it is an association, no proof of a cause.",
    )


def _effect(one: dict[str, Any]) -> str:
    return f"{one['effect']:+.2f}"


def write_robustness_table(summary: dict[str, Any], path: Path) -> None:
    """Write the shares as a Markdown table, with the conditions that hold for them."""
    write_whole(path, quotable(robustness_table(summary), summary.get("conditions", {})))
