"""Columns of tables of cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import BaseModel

from deploy.reports.studies.case_result import COMPENSATION, Case, CasesResult
from deploy.reports.studies.study_texts import ceiling_text
from deploy.reports.tables import Cell, Column, Shown, Value, scaled, shown_in

TableColumn = tuple[Column, Callable[[Any], Cell | Value]]
"""A column, and what a case or a point of a study has in it."""

_UNREMARKABLE = ("", "starting", None)
_OPTIONAL: list[TableColumn] = [
    (Column("Compensation", brief="Compen-\nsation", is_text=True),
     lambda case: COMPENSATION[case.compensation]),
    (Column("Drive loop", brief="Drive\nloop", is_text=True),
     lambda case: COMPENSATION[case.drive_feedback]),
    (Column("Loop", is_text=True), lambda case: "running" if case.running else "starting"),
    (Column("Held-arm ceiling", brief=None), ceiling_text),
]  # fmt: skip


def case_columns(summary: CasesResult[Case]) -> list[TableColumn]:
    """Return the columns that describe a case, without those that are empty for all."""
    return [
        (Column("Arm", is_text=True), lambda case: case.arm),
        (Column("Law", is_text=True), lambda case: case.law),
        *(
            (column, text)
            for column, text in _OPTIONAL
            if any(text(case) not in _UNREMARKABLE for case in summary.cases)
        ),
    ]


def shown_columns(
    part: type[BaseModel], of: Callable[[Any], BaseModel | None] = lambda item: item
) -> list[TableColumn]:
    """Return a column for each field of a part that is `Shown`.

    Args:
        part: class of the part.
        of: returns the part of an item; None where there is none.
    """

    def column(name: str, shown: Shown) -> TableColumn:
        return shown, lambda item: scaled(getattr(of(item), name, None), shown.factor)

    return [column(name, shown) for name, shown in shown_in(part).items()]
