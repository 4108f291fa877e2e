"""Results of sweeps and margins in words and as tables, and the names of their cases."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from deploy.reports.tables import ABSENT, Cell, Column, Table, Value, quotable, scaled, table_of

_SHOWN_EFFECTS = 6
Summary = dict[str, Any]
TableColumn = tuple[Column, Callable[[Summary], Cell | Value]]
"""A column, and what a case or a point of a study has in it."""

COMPENSATION = {None: "", False: "without", True: "with"}


def setting_text(case: Summary) -> str:
    """With what a law has a margin: compensation, feedback at the drives, a loop that runs."""
    said = [
        f"{COMPENSATION[case['compensation']]} compensation",
        f"{COMPENSATION[case['drive_feedback']]} drive feedback",
    ]
    parts = [text for text in said if not text.startswith(" ")]
    return ", ".join([*parts, *(["running"] if case["running"] else [])])


def case_name(case: Summary) -> str:
    """What a margin is of: the law, and with what."""
    return f"{case['law']} {setting_text(case)}".rstrip()


def case_title(case: Summary) -> str:
    """The same with its arm."""
    return f"{case['arm']}, {case_name(case)}"


def ceiling_text(case: Summary) -> str | None:
    """The held-arm ceiling of a case, as far as there is one."""
    ceiling = case["held_arm_ceiling_ms"]
    return None if ceiling is None else f"{ceiling:.0f} ms"


def value_text(value: float, summary: Summary) -> str:
    """A value with its unit."""
    return f"{value:g} {summary['unit']}".rstrip()


def value_title(summary: Summary) -> str:
    """What grows, with its unit."""
    return Column(summary["title"], summary["unit"]).title


def interval_text(share: Summary) -> str:
    """Wilson's interval of a share in per cent."""
    if share["wilson_95"] is None:
        return ABSENT
    low, high = (100 * end for end in share["wilson_95"])
    return f"{low:.0f}–{high:.0f} %"


def share_text(share: Summary) -> str:
    """How many of how many were kept."""
    return f"{share['kept']} of {share['total']}" if share["total"] else ABSENT


_UNREMARKABLE = ("", "starting", None)
_OPTIONAL: list[TableColumn] = [
    (Column("Compensation", brief="Compen-\nsation", is_text=True),
     lambda case: COMPENSATION[case["compensation"]]),
    (Column("Drive feedback", brief="Drive\nfeedback", is_text=True),
     lambda case: COMPENSATION[case["drive_feedback"]]),
    (Column("Loop", is_text=True), lambda case: "running" if case["running"] else "starting"),
    (Column("Held-arm ceiling", brief="Held-arm\nceiling"), ceiling_text),
]  # fmt: skip


def _case_columns(summary: Summary) -> list[TableColumn]:
    """What a case is; some only where one of the cases has something to say in it."""
    return [
        (Column("Arm", is_text=True), lambda case: case["arm"]),
        (Column("Law", is_text=True), lambda case: case["law"]),
        *(
            (column, text)
            for column, text in _OPTIONAL
            if any(text(case) not in _UNREMARKABLE for case in summary["cases"])
        ),
    ]


def shown_value(value: Any) -> str:
    """A swept value; whole numbers without a decimal point."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def margin_figure(case: Summary) -> str:
    """A margin without its unit; that it is beyond the limit, or that there is none."""
    if not case["completed"]:
        return "not known yet"
    if case["margin"] is None:
        return "none"
    beyond = "≥ " if case["growth"] > 0 else "≤ "
    sign = beyond if case["first_failure"] is None else ""
    return f"{sign}{case['margin']:g}"


def margin_text(case: Summary, summary: Summary) -> str:
    """A margin with its unit."""
    has_unit = case["completed"] and case["margin"] is not None
    return f"{margin_figure(case)} {summary['unit'] if has_unit else ''}".rstrip()


def probe_at(case: Summary, value: float | None) -> Summary | None:
    """What became of a value that was tried."""
    return next((probe for probe in case["probes"] if probe["value"] == value), None)


def headlines(summary: Summary) -> list[str]:
    """Who takes the most on each arm: first of loops that run, then of those that start so."""
    arms = dict.fromkeys(case["arm"] for case in summary["cases"])
    return [
        _best(summary, own, arm)
        for arm in arms
        for running in (True, False)
        if (own := [c for c in summary["cases"] if (c["arm"], c["running"]) == (arm, running)])
    ]


def _best(summary: Summary, cases: list[Summary], arm: str) -> str:
    """Who takes the most of the cases of an arm."""
    known = [case for case in cases if case["margin"] is not None]
    where = f"{arm}, a loop that already runs" if cases[0]["running"] else arm
    if not known:
        return f"{where}: no law keeps its bounds at all."
    best = max(known, key=lambda case: case["growth"] * case["margin"])
    others = [case_name(case) for case in known if case["margin"] == best["margin"]]
    margin = f"{furthest(summary)} margin is {margin_text(best, summary)}"
    return f"{where}: the {margin}, of {' and '.join(others)}."


def held_again(summary: Summary) -> list[str]:
    """A sentence for each case that kept its bounds once more beyond its first failure."""
    return [
        f"{case_title(case)}: held again at"
        f" {', '.join(f'{value:g}' for value in case['held_again'])}, beyond its first failure."
        for case in summary["cases"]
        if case["held_again"]
    ]


def furthest(summary: Summary) -> str:
    """What a margin is of the values that held: the largest, or where values shrink the least."""
    return "smallest" if any(case["growth"] < 0 for case in summary["cases"]) else "largest"


def _margin_title(summary: Summary) -> str:
    held_at = f"{furthest(summary)} {summary['title']} at which the bounds are kept"
    return f"{summary['name']} · {held_at}"


def margin_table(summary: Summary) -> Table:
    """Margins, a row for each law on each arm."""

    def at(case: Summary, key: str, quantity: str, factor: float) -> Value:
        """A mean at the margin or at the first failure."""
        probe = probe_at(case, case[key])
        return scaled(probe[quantity]["mean"], factor) if probe else None

    def on(physics: str) -> TableColumn:
        return Column(f"On {physics}", summary["unit"]), lambda case: case["margin_on"].get(physics)

    def failure(case: Summary) -> Value:
        value = case["first_failure"]
        return None if value is None else value_text(value, summary)

    elsewhere = dict.fromkeys(on for case in summary["cases"] for on in case.get("margin_on", ()))
    return table_of(
        _margin_title(summary),
        [
            *_case_columns(summary),
            (Column("Margin", brief="Held"), lambda case: margin_text(case, summary)),
            *map(on, elsewhere),
            (Column("First failure", brief="First\nfailure"), failure),
            (Column("Ticks outside at first failure", "%", "Outside\nthere"),
             lambda case: at(case, "first_failure", "violation_fraction", 100.0)),
            (Column("RMS error of the worst joint at the margin", "mrad", None),
             lambda case: at(case, "margin", "worst_rms_rad", 1e3)),
            (Column("Held again at", brief=None),
             lambda case: ", ".join(f"{value:g}" for value in case["held_again"]) or ABSENT),
        ],
        summary["cases"],
        "A value holds if the bounds are kept from every start with every seed; the margin is the"
        f" {furthest(summary)} value up to which all that were probed held. Held-arm ceiling: until"
        " the first command acts the brakes hold the arm, and from the worst start its error leaves"
        " the funnel after this time; no law can start under a longer delay.",
    )  # fmt: skip


def point_table(summary: Summary) -> Table:
    """The points of a sweep, a row each."""

    def value_of(place: int, axis: Summary) -> TableColumn:
        keys = ", ".join(axis["keys"])
        brief = keys.replace(", ", "\n").replace(".", ".\n")
        return Column(keys, brief=brief), lambda point: shown_value(point["values"][place])

    def spread(key: str, which: str, factor: float) -> Callable[[Summary], Value]:
        return lambda point: scaled(point[key][which], factor)

    plants: list[TableColumn] = [
        (Column("Plants kept", brief="Plants\nkept"), share_text),
        (Column("Wilson's 95 % interval"), interval_text),
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
    )  # fmt: skip


def margins_by_law(summary: Summary) -> Table:
    """Margins for documents: a row per law, a column per arm and setting; and the ceilings."""
    columns = {(case["arm"], setting_text(case)): case for case in summary["cases"]}
    margins = {
        (case["law"], case["arm"], setting_text(case)): margin_text(case, summary)
        for case in summary["cases"]
    }
    headings = [f"{arm}, {setting}" if setting else arm for arm, setting in columns]
    laws = dict.fromkeys(case["law"] for case in summary["cases"])
    rows = [[f"`{law}`", *(margins[law, *column] for column in columns)] for law in laws]
    ceilings = [ceiling_text(case) for case in columns.values()]
    if any(ceilings):
        rows.append(["held-arm ceiling", *(ceiling or ABSENT for ceiling in ceilings)])
    return Table(_margin_title(summary), list(map(Column, ("law", *headings))), rows)


def kept_text(case: Summary, summary: Summary) -> str:
    """Up to where enough plants are kept."""
    if case["kept_up_to"] is None:
        is_judged = case["values"][0]["total"] == summary["plants"]
        return "none" if is_judged else "not known yet"
    return value_text(case["kept_up_to"], summary)


def robustness_table(summary: Summary) -> Table:
    """How many plants were kept at each value, a row for each case."""
    plants, share = summary["plants"], f"{100 * summary['kept_share']:g} %"

    def kept_at(place: int, value: float) -> TableColumn:
        """How many were kept; of how many where not all are judged yet."""

        def count(case: Summary) -> Value:
            found = case["values"][place]
            return str(found["kept"]) if found["total"] == plants else share_text(found)

        return Column(f"{value:g}"), count

    return table_of(
        f"{summary['name']} · of {plants} plants, kept their bounds, by {value_title(summary)}",
        [
            *_case_columns(summary),
            (Column(f"{share} kept up to", brief=f"{share}\nup to"),
             lambda case: kept_text(case, summary)),
            *(kept_at(place, value) for place, value in enumerate(summary["values"])),
        ],
        summary["cases"],
        f"Plants 1 to {plants} of plant_seed {summary['plant_seed']}, the same in every"
        " cell. A plant is kept if it is with every seed. The held-arm ceiling is that of the plant"
        " that has the least: no law can start it under a longer delay.",
    )  # fmt: skip


def interval_table(summary: Summary) -> Table:
    """The shares with their intervals, a row for each case and value."""
    return table_of(
        "Shares with their uncertainty",
        [
            (Column("Case", is_text=True), lambda at: case_title(at["case"])),
            (Column(summary["title"], summary["unit"]), lambda at: at["value"]),
            (Column("Kept"), share_text),
            (Column("Wilson's 95 % interval"), interval_text),
            (Column("Cannot start: beyond their held-arm ceiling"),
             lambda at: float(at["beyond_held_arm_ceiling"])),
        ],
        [{**value, "case": case} for case in summary["cases"] for value in case["values"]],
        "The interval says how far the share of all plants that could be drawn may lie from that of"
        " those that were.",
    )  # fmt: skip


def losses_table(summary: Summary) -> Table:
    """What lost plants have in common, the strongest first."""
    rows: list[list[Value]] = []
    for case in summary["cases"]:
        losses, name = case["losses"], case_title(case)
        counts = f"{losses['lost_plants']} / {losses['kept_plants']}"
        if losses["effects"] is None:
            rows.append([name, "too few lost or kept to say", None, None, counts])
            continue
        for one in losses["effects"][:_SHOWN_EFFECTS]:
            effect = f"{one['effect']:+.2f}"
            rows.append([name, one["quantity"], effect, losses["chance_level"], counts])
            name = counts = ""
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


def result_tables(summary: Summary) -> list[Table]:
    """The tables of a study's report."""
    if summary["kind"] == "sweep":
        return [point_table(summary)]
    if summary["kind"] == "margin":
        return [margin_table(summary)]
    return [robustness_table(summary), interval_table(summary), losses_table(summary)]


def write_study_table(summary: Summary, path: Path) -> None:
    """Write margins, or how many plants were kept, as a Markdown table with its conditions."""
    is_margin = summary["kind"] == "margin"
    table = margins_by_law(summary) if is_margin else robustness_table(summary)
    write_whole(path, quotable(table, summary.get("conditions", {})))
