"""What the cases of a study are called."""

from __future__ import annotations

from typing import Any

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
