"""Parts of pages about cases: their curves by arm, and the names of their values."""

from __future__ import annotations

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import Curve, DrawnStudy, StudyQuantity
from deploy.reports.page import Fact, Panel
from deploy.reports.studies.case_result import (
    Case,
    CasesResult,
    TriedValue,
    case_name,
    case_title,
    setting_text,
)
from deploy.reports.studies.study_texts import value_text, value_title


def curves_panel(
    summary: CasesResult[Case], arm: str, own: list[Case], name: str, quantity: StudyQuantity,
    caption: str, title: str = "",
) -> Panel[DrawnStudy]:  # fmt: skip
    """A line for each case of an arm: laws by colour, or of one law its settings.

    Lines are dashed without compensation, and dash-dotted with a drive loop. Points
    of loops that already run are hollow.
    """
    laws = list(dict.fromkeys(case.law for case in summary.cases))
    settings = list(dict.fromkeys(map(setting_text, summary.cases)))
    has_key = min(len(laws), len(settings)) > 1 and len(own) >= len(laws) + len(settings)
    lines = []
    for case in own:
        law, setting = laws.index(case.law), settings.index(setting_text(case))
        dash = (case.compensation is False) + 2 * bool(case.drive_feedback)
        points = [(runs.value, runs) for runs in case.tried if runs.runs]
        colour = law if len(laws) > 1 else setting
        key = (case.law, setting_text(case)) if has_key else None
        lines.append(Curve(case_name(case), colour, dash, points, case.running, key))
    return Panel(
        "Plants" if name == "kept" else arm, f"{name}-{arm}", title or quantity.title,
        lambda study: study_figures.curves(study, lines, value_title(summary), quantity),
        caption, is_clickable=True,
    )  # fmt: skip


def value_name(case: Case, tried: TriedValue, summary: CasesResult[Case]) -> str:
    """Return the name of a value that was tried in a case."""
    return f"{case_title(case)}, {value_text(tried.value, summary)}"


def durations(summary: CasesResult[Case]) -> Fact:
    """Return the duration of a run on each arm."""
    durations = summary.duration_s.items()
    return Fact("Duration of a run", ", ".join(f"{arm} {length:g} s" for arm, length in durations))


def cases_by_arm(summary: CasesResult[Case]) -> dict[str, list[Case]]:
    """Group cases by their arm."""
    found: dict[str, list[Case]] = {}
    for case in summary.cases:
        found.setdefault(case.arm, []).append(case)
    return found
