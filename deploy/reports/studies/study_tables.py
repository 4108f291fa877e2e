"""Results of sweeps and margins as tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deploy.reports.studies import study_texts as texts
from deploy.reports.tables import ABSENT, Cell, Column, Table, Value, scaled, table_of
from deploy.study.study import shown_value

_SHOWN_EFFECTS = 6
_SHOWN_POINTS = 40
Summary = dict[str, Any]
TableColumn = tuple[Column, Callable[[Summary], Cell | Value]]
"""A column, and what a case or a point of a study has in it."""

_UNREMARKABLE = ("", "starting", None)
_OPTIONAL: list[TableColumn] = [
    (Column("Compensation", brief="Compen-\nsation", is_text=True),
     lambda case: texts.COMPENSATION[case["compensation"]]),
    (Column("Drive feedback", brief="Drive\nfeedback", is_text=True),
     lambda case: texts.COMPENSATION[case["drive_feedback"]]),
    (Column("Loop", is_text=True), lambda case: "running" if case["running"] else "starting"),
    (Column("Held-arm ceiling", brief=None), texts.ceiling_text),
]  # fmt: skip


def _case_columns(summary: Summary) -> list[TableColumn]:
    """Return the columns that describe a case, without those that are empty for all."""
    return [
        (Column("Arm", is_text=True), lambda case: case["arm"]),
        (Column("Law", is_text=True), lambda case: case["law"]),
        *(
            (column, text)
            for column, text in _OPTIONAL
            if any(text(case) not in _UNREMARKABLE for case in summary["cases"])
        ),
    ]


def _margin_title(summary: Summary) -> str:
    held_at = f"{texts.furthest(summary)} {summary['title']} at which the bounds are kept"
    return f"{summary['name']} · {held_at}"


def margin_table(summary: Summary) -> Table:
    """Margins, a row for each law on each arm."""

    def at(case: Summary, key: str, quantity: str, factor: float) -> Value:
        """A mean at the margin or at the first failure."""
        probe = texts.probe_at(case, case[key])
        return scaled(probe[quantity]["mean"], factor) if probe and quantity in probe else None

    def on(physics: str) -> TableColumn:
        return Column(f"On {physics}", summary["unit"]), lambda case: case["margin_on"].get(physics)

    def failure(case: Summary) -> Value:
        value = case["first_failure"]
        return None if value is None else texts.value_text(value, summary)

    held: TableColumn = Column("Held"), lambda case: texts.margin_text(case, summary)
    in_theory: TableColumn = Column("Stable in theory", brief="In\ntheory"), texts.theory_text
    every_pattern: TableColumn = (
        Column("Every pattern", brief="Every\npattern"),
        lambda case: texts.pattern_text(case, summary),
    )
    smaller_rotors: TableColumn = (
        Column("Margin with rotors × 0.1", brief="Rotors\n× 0.1"),
        lambda case: texts.rotors_text(case, summary),
    )
    ticks_outside: TableColumn = (
        Column("Ticks outside at first failure", "%", "Outside\nthere"),
        lambda case: at(case, "first_failure", "violation_fraction", 100.0),
    )
    first_outside: TableColumn = (  # of runs that end there
        Column("First tick outside at first failure", "s", None),
        lambda case: at(case, "first_failure", "first_violation_s", 1.0),
    )
    elsewhere = dict.fromkeys(on for case in summary["cases"] for on in case.get("margin_on", ()))
    return table_of(
        _margin_title(summary),
        [
            *_case_columns(summary),
            (Column("Margin"),
             lambda case: texts.quoted_text(case, summary)),
            *([held] if any(map(texts.because_text, summary["cases"])) else []),
            *([in_theory] if any(map(texts.theory_text, summary["cases"])) else []),
            *([every_pattern] if any(map(every_pattern[1], summary["cases"])) else []),
            *([smaller_rotors] if any(map(smaller_rotors[1], summary["cases"])) else []),
            *map(on, elsewhere),
            (Column("First failure", brief="First\nfailure"), failure),
            ticks_outside if any(map(ticks_outside[1], summary["cases"])) else first_outside,
            (Column("Lost by", brief="Lost\nby", is_text=True), texts.loss_text),
            (Column("RMS error of the worst joint at the margin", "mrad", None),
             lambda case: at(case, "margin", "worst_rms_rad", 1e3)),
            (Column("Held again at", brief=None),
             lambda case: ", ".join(f"{value:g}" for value in case["held_again"]) or ABSENT),
        ],
        summary["cases"],
        "The margin is the smallest of all that is known. A loop starts with the full"
        " value, or is running, and the value grows while the arm moves. A value holds if the"
        " bounds are kept from every start with every seed; held is the"
        f" {texts.furthest(summary)} value up to"
        " which all tested values held, theory is for the linear loop. Held-arm"
        " ceiling: until the first command acts the brakes hold the arm, and from the worst"
        " start its error leaves the funnel after this time; no law can start under a longer"
        " delay. Every pattern: the margin for delays that vary; guaranteed where each"
        " command waits until its play-out, a fixed time after its state, or"
        " where so many patterns were tried, the largest value at which all of them held.",
    )  # fmt: skip


def help_tables(summary: Summary, folder: str = "") -> list[Table]:
    """Return tables of the changes tried at the first failure of each case, with their commands.

    Args:
        summary: of margins.
        folder: of the margins, seen from the page, with a slash.
    """
    repeat = "funnel-hil simulate {folder}scenarios/{point}.yaml --set seed={seed}"
    columns: list[TableColumn] = [
        (Column("Change", is_text=True), lambda each: each["change"]),
        (Column("Kept", is_text=True), lambda each: "yes" if each["held"] else "no"),
        (Column("Starts tried", brief="Starts"), lambda each: each.get("starts")),
        (Column("Bound left", "%"), lambda each: scaled(each["margin_min"], 100.0)),
        (Column("RMS error of the worst joint", "mrad", "RMS error"),
         lambda each: scaled(each["worst_rms_rad"], 1e3)),
        (Column("Command, in the folder of this page", brief=None, is_text=True),
         lambda each: repeat.format(folder=folder, **each)),
    ]  # fmt: skip
    return [
        table_of(
            f"What helps at {texts.value_text(helps['value'], summary)}, {texts.case_title(case)}",
            columns,
            helps["tried"],
        )
        for case in summary["cases"]
        if (helps := case.get("what_helps")) is not None
    ]


def disturbance_tables(summary: Summary) -> list[Table]:
    """Up to where cases hold with messages lost, late or overtaken: one table, or none."""

    def value(key: str, missing: str) -> Callable[[Summary], Value]:
        return lambda row: missing if row[key] is None else texts.value_text(row[key], summary)

    rows = [
        {"case": case, **found}
        for case in summary["cases"]
        for found in case.get("disturbances") or ()
    ]
    table = table_of(
        f"{summary['name']} · {summary['title']} at which the bounds are kept with messages late,"
        " lost or overtaken",
        [
            (Column("Case", is_text=True), lambda row: texts.case_title(row["case"])),
            (Column("Every pattern, in order, none lost", brief="Every\npattern"),
             lambda row: texts.pattern_text(row["case"], summary)),
            (Column("Disturbance", is_text=True), lambda row: row["disturbance"]),
            (Column("Bridge", is_text=True), lambda row: "with" if row["bridge"] else "without"),
            (Column("Kept up to", brief="Kept\nup to"), value("held_up_to", "none")),
            (Column("Lost at", brief="Lost\nat"), value("lost_at", ABSENT)),
        ],
        rows,
        "Tried at the margin, its half and its quarter; other losses of this size may be worse."
        " Both directions are disturbed, losses and late messages every 0.2 s in each.",
    )  # fmt: skip
    return [table] if rows else []


def point_table(summary: Summary) -> Table:
    """The points of a sweep, a row each."""

    def value_of(place: int, axis: Summary) -> TableColumn:
        keys = ", ".join(axis["keys"])
        brief = keys.replace(", ", "\n").replace(".", ".\n")
        return Column(keys, brief=brief), lambda point: shown_value(point["values"][place])

    def spread(key: str, which: str, factor: float) -> Callable[[Summary], Value]:
        return lambda point: scaled(point[key][which], factor)

    plants: list[TableColumn] = [
        (Column("Plants kept", brief="Plants\nkept"), texts.share_text),
        (Column("Wilson's 95 % interval"), texts.interval_text),
    ]
    return table_of(
        f"{summary['name']} · {summary['scenario']}",
        [
            (Column("Point", brief=None, is_text=True), lambda point: point["point"]),
            *(value_of(place, axis) for place, axis in enumerate(summary["axes"])),
            *(plants if summary["plants"] is not None else ()),
            (Column("Runs that kept their bounds", brief="Bounds\nkept"),
             lambda point: f"{point['runs_kept']} of {point['runs']}"),
            (Column("Ticks outside", "%", "Outside"), spread("violation_fraction", "mean", 100.0)),
            (Column("Ticks outside in the worst run", "%", None),
             spread("violation_fraction", "highest", 100.0)),
            (Column("RMS error of the worst joint", "mrad", "Worst\nRMS"),
             spread("worst_rms_rad", "mean", 1e3)),
            (Column("Failed runs", brief="Failed"), lambda point: point["runs_failed"]),
        ],
        summary["points"],
        "Means over the seeds and plants of a point; the worst run is the one with the most ticks"
        " outside.",
        _SHOWN_POINTS,
    )  # fmt: skip


def margins_by_law(summary: Summary) -> Table:
    """Margins for documents: a row per law, a column per arm and setting; and the ceilings."""
    columns = {(case["arm"], texts.setting_text(case)): case for case in summary["cases"]}
    margins = {}
    for case in summary["cases"]:
        pattern, margin = texts.pattern_text(case, summary), texts.quoted_text(case, summary)
        cell = margin if pattern is None else f"{margin}; every pattern: {pattern}"
        margins[case["law"], case["arm"], texts.setting_text(case)] = cell
    headings = [f"{arm}, {setting}" if setting else arm for arm, setting in columns]
    laws = dict.fromkeys(case["law"] for case in summary["cases"])
    rows = [[f"`{law}`", *(margins[law, *column] for column in columns)] for law in laws]
    ceilings = [texts.ceiling_text(case) for case in columns.values()]
    if any(ceilings):
        rows.append(["held-arm ceiling", *(ceiling or ABSENT for ceiling in ceilings)])
    return Table(_margin_title(summary), list(map(Column, ("law", *headings))), rows)


def robustness_table(summary: Summary) -> Table:
    """Return the number of plants kept at each value, a row for each case."""
    plants = summary["plants"]
    share = f"{100 * summary['kept_share']:g} % of {plants}"

    def kept_at(place: int, value: float) -> TableColumn:
        """Return the number kept, and the number judged where that is not all."""

        def count(case: Summary) -> Value:
            found = case["values"][place]
            return str(found["kept"]) if found["total"] == plants else texts.share_text(found)

        return Column(f"{value:g}"), count

    return table_of(
        f"{summary['name']} · plants of {plants} that kept their bounds, by"
        f" {texts.value_title(summary)}",
        [
            *_case_columns(summary),
            (Column(f"{share} kept up to (95 % interval there)", brief=f"{share}\nup to"),
             lambda case: texts.kept_text(case, summary)),
            *(kept_at(place, value) for place, value in enumerate(summary["values"])),
        ],
        summary["cases"],
        f"Plants 1 to {plants} of plant_seed {summary['plant_seed']} in this order: all of them,"
        " or as many as decide. A plant counts if it keeps its bounds with every seed. The held-arm"
        " ceiling is the smallest one of all plants: no law can start that plant with a longer"
        " delay.",
    )  # fmt: skip


def interval_table(summary: Summary) -> Table:
    """The shares with their intervals, a row for each case and value."""
    return table_of(
        "Shares with their uncertainty",
        [
            (Column("Case", is_text=True), lambda at: texts.case_title(at["case"])),
            (Column(summary["title"], summary["unit"]), lambda at: at["value"]),
            (Column("Kept"), texts.share_text),
            (Column("95 % interval"), texts.interval_text),
            (Column("Cannot start: above their held-arm ceiling"),
             lambda at: float(at["beyond_held_arm_ceiling"])),
        ],
        [{**value, "case": case} for case in summary["cases"] for value in case["values"]],
        "The interval is for the share of all plants that could be drawn, of which these are a"
        " sample: Wilson's, or where a sequential test ended with them, its exact one.",
        most_printed=0,
    )  # fmt: skip


def losses_table(summary: Summary) -> Table:
    """Common properties of lost plants, the strongest first."""
    rows: list[list[Value]] = []
    for case in summary["cases"]:
        losses, name = case["losses"], texts.case_title(case)
        counts = f"{losses['lost_plants']} / {losses['kept_plants']}"
        if losses["effects"] is None:
            rows.append([name, "too few lost or kept plants", None, None, counts])
            continue
        for one in losses["effects"][:_SHOWN_EFFECTS]:
            effect = f"{one['effect']:+.2f}"
            rows.append([name, one["quantity"], effect, losses["chance_level"], counts])
            name = counts = ""
    return Table(
        "Common properties of lost plants",
        [
            Column("Case", is_text=True),
            Column("Drawn quantity", is_text=True),
            Column("Effect"),
            Column("Chance level", brief="Chance"),
            Column("Plants lost / kept", brief="Lost /\nkept"),
        ],
        rows,
        "Effect: +1 if every lost plant had more of the quantity than every kept one, −1 if less."
        " Effects below the chance level may be chance.",
    )
