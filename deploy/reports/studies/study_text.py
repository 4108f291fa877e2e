"""What the cases of a study are called, and what its tables say of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deploy.reports.tables import Column

CaseText = Callable[[dict[str, Any]], str | None]
"""What a case has in a column."""

COMPENSATION = {None: "", False: "without", True: "with"}


def setting_text(case: dict[str, Any]) -> str:
    """With what a law has a margin: compensation, feedback at the drives, a loop that runs."""
    said = [
        f"{COMPENSATION[case['compensation']]} compensation",
        f"{COMPENSATION[case['drive_feedback']]} drive feedback",
    ]
    parts = [text for text in said if not text.startswith(" ")]
    return ", ".join([*parts, *(["running"] if case["running"] else [])])


def case_name(case: dict[str, Any]) -> str:
    """What a margin is of: the law, and with what."""
    return f"{case['law']} {setting_text(case)}".rstrip()


def ceiling_text(case: dict[str, Any]) -> str | None:
    """The held-arm ceiling of a case, as far as there is one."""
    ceiling = case["held_arm_ceiling_ms"]
    return None if ceiling is None else f"{ceiling:.0f} ms"


def optional_columns(summary: dict[str, Any]) -> list[tuple[Column, CaseText]]:
    """Columns that only some studies have something to say in."""
    cases, columns = summary["cases"], list[tuple[Column, CaseText]]()
    if any(case["compensation"] is not None for case in cases):
        compensation = Column("Compensation", brief="Compen-\nsation", is_text=True)
        columns.append((compensation, lambda case: COMPENSATION[case["compensation"]]))
    if any(case["drive_feedback"] is not None for case in cases):
        feedback = Column("Drive feedback", brief="Drive\nfeedback", is_text=True)
        columns.append((feedback, lambda case: COMPENSATION[case["drive_feedback"]]))
    if any(case["running"] for case in cases):
        loop = Column("Loop", is_text=True)
        columns.append((loop, lambda case: "running" if case["running"] else "starting"))
    if any(map(ceiling_text, cases)):
        columns.append((Column("Held-arm ceiling", brief="Held-arm\nceiling"), ceiling_text))
    return columns
