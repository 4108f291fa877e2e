"""What `--confirm` found, as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from deploy.reports.tables import Cell, Column, Table, scaled
from deploy.runs.confirmation import CONFIRMATION, NEAR_ZERO


def confirmation_tables(summaries: Sequence[Mapping[str, Any]]) -> list[Table]:
    """The table of all confirmations in some summaries; none where there is no confirmation."""
    found = [each for summary in summaries for each in summary.get(CONFIRMATION) or ()]
    if not found:
        return []
    columns = [
        Column("Scenario", brief=None, is_text=True),
        Column("Law", is_text=True),
        Column("On", is_text=True),
        Column("Runs"),
        Column("Same verdict", brief="Same"),
        Column("Another verdict", brief="Other"),
        Column("Too near to call", brief="Near"),
        Column("Smallest margins differ by at most", "%", "Margin\n±"),
        Column("True errors differ by at most", "mrad", "Error\n±"),
    ]
    rows = [
        [
            each["scenario"], each["law"], each["physics"], each["runs"], each["agree"],
            Cell(each["differ"], "bad" if each["differ"] else ""), each["too_near"],
            scaled(each["margin_difference"], 100.0), scaled(each["error_difference_rad"], 1e3),
        ]
        for each in found
    ]  # fmt: skip
    return [Table("Confirmation on other physics", columns, rows, _NOTE)]


_NOTE = (
    "The same runs with the same controller, channel and hardware, on other rigid-body physics. A"
    f" verdict that differs is too near to call where a smallest margin is within {NEAR_ZERO:.0%}"
    " of the bound from zero."
)
