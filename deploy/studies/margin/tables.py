"""Tables of margins."""

from __future__ import annotations

from deploy.reports.studies.case_result import case_title, setting_text
from deploy.reports.studies.study_result import Spread
from deploy.reports.studies.study_tables import TableColumn, case_columns
from deploy.reports.studies.study_texts import ceiling_text, value_text
from deploy.reports.tables import ABSENT, Column, Table, Value, scaled, table_of
from deploy.studies.margin.result import MarginCase, MarginResult
from deploy.studies.margin.texts import (
    because_text,
    furthest,
    loss_text,
    margin_text,
    pattern_text,
    quoted_text,
    rotors_text,
    theory_text,
)


def _margin_title(summary: MarginResult) -> str:
    held_at = f"{furthest(summary)} {summary.title} at which the bounds are kept"
    return f"{summary.name} · {held_at}"


def margin_table(summary: MarginResult) -> Table:
    """Margins, a row for each law on each arm."""

    def at(case: MarginCase, key: str, quantity: str, factor: float) -> Value:
        """A mean at the margin or at the first failure."""
        probe = case.probe_at(getattr(case, key))
        spread: Spread | None = getattr(probe, quantity, None)
        return None if spread is None else scaled(spread.mean, factor)

    def on(physics: str) -> TableColumn:
        return Column(f"On {physics}", summary.unit or ""), lambda case: case.margin_on.get(physics)

    def failure(case: MarginCase) -> Value:
        value = case.first_failure
        return None if value is None else value_text(value, summary)

    held: TableColumn = Column("Held"), lambda case: margin_text(case, summary)
    in_theory: TableColumn = Column("Stable in theory", brief="In\ntheory"), theory_text
    every_pattern: TableColumn = (
        Column("Every pattern, arm as given", brief="Every\npattern"),
        lambda case: pattern_text(case, summary),
    )
    smaller_rotors: TableColumn = (
        Column("Margin with rotors × 0.1", brief="Rotors\n× 0.1"),
        lambda case: rotors_text(case, summary),
    )
    ticks_outside: TableColumn = (
        Column("Ticks outside at first failure", "%", "Outside\nthere"),
        lambda case: at(case, "first_failure", "violation_fraction", 100.0),
    )
    first_outside: TableColumn = (  # of runs that end there
        Column("Lost after", "s", None),
        lambda case: at(case, "first_failure", "first_violation_s", 1.0),
    )
    held_again: TableColumn = (
        Column("Held again at", brief=None),
        lambda case: ", ".join(f"{value:g}" for value in case.held_again) or ABSENT,
    )
    elsewhere = dict.fromkeys(on for case in summary.cases for on in case.margin_on)
    return table_of(
        _margin_title(summary),
        [
            *case_columns(summary),
            (Column("Margin to quote", brief="To\nquote"),
             lambda case: quoted_text(case, summary)),
            *([held] if any(map(because_text, summary.cases)) else []),
            *([in_theory] if any(map(theory_text, summary.cases)) else []),
            *([every_pattern] if any(map(every_pattern[1], summary.cases)) else []),
            *([smaller_rotors] if any(map(smaller_rotors[1], summary.cases)) else []),
            *map(on, elsewhere),
            (Column("First failure", brief="First\nfailure"), failure),
            ticks_outside if any(map(ticks_outside[1], summary.cases)) else first_outside,
            (Column("Lost by", brief="Lost\nby", is_text=True), loss_text),
            (Column("RMS error there", "mrad", None),
             lambda case: at(case, "margin", "worst_rms_rad", 1e3)),
            *([held_again] if any(case.held_again for case in summary.cases) else []),
        ],
        summary.cases,
        "The margin to quote is the smallest of all that is known; held and every pattern are of"
        " the arm as given, the best case. RMS error there: of the worst joint, at the margin. A"
        " loop starts with the full value, or is running, and the value grows while the arm moves."
        " A value holds if the bounds are kept from every start with every seed; held is the"
        f" {furthest(summary)} value up to which all tested values held, theory is for the linear"
        " loop. Held-arm ceiling: until the first command acts the brakes hold the arm, and from"
        " the worst start its error leaves the funnel after this time; no law can start under a"
        " longer delay. Every pattern: the margin for delays that vary; guaranteed where each"
        " command waits until its play-out, a fixed time after its state, or where so many"
        " patterns were tried, the largest value at which all of them held.",
    )  # fmt: skip


def help_tables(summary: MarginResult, folder: str = "") -> list[Table]:
    """Return tables of the changes tried at the first failure of each case, with their commands.

    Args:
        summary: of margins.
        folder: of the margins, seen from the page, with a slash.
    """
    repeat = "funnel-hil simulate {folder}scenarios/{point}.yaml --set seed={seed}"
    columns: list[TableColumn] = [
        (Column("Change", is_text=True), lambda each: each.change),
        (Column("Kept", is_text=True), lambda each: "yes" if each.held else "no"),
        (Column("Starts tried", brief="Starts"), lambda each: each.starts),
        (Column("Bound left", "%"), lambda each: scaled(each.margin_min, 100.0)),
        (Column("RMS error of the worst joint", "mrad", "RMS error"),
         lambda each: scaled(each.worst_rms_rad, 1e3)),
        (Column("Command, in the folder of this page", brief=None, is_text=True),
         lambda each: repeat.format(folder=folder, point=each.point, seed=each.seed)),
    ]  # fmt: skip
    return [
        table_of(
            f"What helps at {value_text(helps.value, summary)}, {case_title(case)}",
            columns,
            helps.tried,
        )
        for case in summary.cases
        if (helps := case.what_helps) is not None
    ]


def disturbance_tables(summary: MarginResult) -> list[Table]:
    """Up to where cases hold with messages lost, late or overtaken: one table, or none."""

    def text(value: float | None, missing: str) -> str:
        return missing if value is None else value_text(value, summary)

    rows = [(case, found) for case in summary.cases for found in case.disturbances or ()]
    table = table_of(
        f"{summary.name} · {summary.title} at which the bounds are kept with messages late,"
        " lost or overtaken",
        [
            (Column("Case", is_text=True), lambda row: case_title(row[0])),
            (Column("Every pattern, in order, none lost", brief="Every\npattern"),
             lambda row: pattern_text(row[0], summary)),
            (Column("Disturbance", is_text=True), lambda row: row[1].disturbance),
            (Column("Bridge", is_text=True), lambda row: "with" if row[1].bridge else "without"),
            (Column("Kept up to", brief="Kept\nup to"),
             lambda row: text(row[1].held_up_to, "none")),
            (Column("Lost at", brief="Lost\nat"), lambda row: text(row[1].lost_at, ABSENT)),
        ],
        rows,
        "Tried at the margin, its half and its quarter; other losses of this size may be worse."
        " Both directions are disturbed, losses and late messages every 0.2 s in each.",
    )  # fmt: skip
    return [table] if rows else []


def margins_by_law(summary: MarginResult) -> Table:
    """Margins for documents: a row per law, a column per arm and setting; and the ceilings."""
    columns = {(case.arm, setting_text(case)): case for case in summary.cases}
    margins = {}
    for case in summary.cases:
        pattern, margin = pattern_text(case, summary), quoted_text(case, summary)
        best = "" if case.number == case.any_pattern else " with the arm as given"
        cell = margin if pattern is None else f"{margin}; every pattern{best}: {pattern}"
        margins[case.law, case.arm, setting_text(case)] = cell
    headings = [f"{arm}, {setting}" if setting else arm for arm, setting in columns]
    laws = dict.fromkeys(case.law for case in summary.cases)
    rows = [[f"`{law}`", *(margins[law, *column] for column in columns)] for law in laws]
    ceilings = [ceiling_text(case) for case in columns.values()]
    if any(ceilings):
        rows.append(["held-arm ceiling", *(ceiling or ABSENT for ceiling in ceilings)])
    return Table(_margin_title(summary), list(map(Column, ("law", *headings))), rows)
