"""Tables of margins over uncertain plants."""

from __future__ import annotations

from deploy.reports.studies.case_result import case_title
from deploy.reports.studies.study_tables import TableColumn, case_columns
from deploy.reports.studies.study_texts import interval_text, share_text, value_title
from deploy.reports.tables import Column, Table, Value, table_of
from deploy.studies.robustness.result import Losses, RobustCase, RobustnessResult
from deploy.studies.robustness.sentences import kept_text

_SHOWN_EFFECTS = 6


def robustness_table(summary: RobustnessResult) -> Table:
    """Return the number of plants kept at each value, a row for each case."""
    plants = summary.plants
    share = f"{100 * summary.kept_share:g} % of {plants}"

    def kept_at(place: int, value: float) -> TableColumn:
        """Return the number kept, and the number judged where that is not all."""

        def count(case: RobustCase) -> Value:
            found = case.values[place]
            return str(found.kept) if found.total == plants else share_text(found)

        return Column(f"{value:g}"), count

    return table_of(
        f"{summary.name} · plants of {plants} that kept their bounds, by"
        f" {value_title(summary)}",
        [
            *case_columns(summary),
            (Column(f"{share} kept up to (95 % interval there)", brief=f"{share}\nup to"),
             lambda case: kept_text(case, summary)),
            *(kept_at(place, value) for place, value in enumerate(summary.values)),
        ],
        summary.cases,
        f"Plants 1 to {plants} of plant_seed {summary.plant_seed} in this order: all of them,"
        " or as many as decide. A plant counts if it keeps its bounds with every seed. The held-arm"
        " ceiling is the smallest one of all plants: no law can start that plant with a longer"
        " delay.",
    )  # fmt: skip


def interval_table(summary: RobustnessResult) -> Table:
    """The shares with their intervals, a row for each case and value."""
    return table_of(
        "Shares with their uncertainty",
        [
            (Column("Case", is_text=True), lambda at: case_title(at[0])),
            (Column(summary.title, summary.unit or ""), lambda at: at[1].value),
            (Column("Kept"), lambda at: share_text(at[1])),
            (Column("95 % interval"), lambda at: interval_text(at[1])),
            (Column("Cannot start: above their held-arm ceiling"),
             lambda at: float(at[1].beyond_held_arm_ceiling)),
        ],
        [(case, value) for case in summary.cases for value in case.values],
        "The interval is for the share of all plants that could be drawn, of which these are a"
        " sample: Wilson's, or where a sequential test ended with them, its exact one.",
        most_printed=0,
    )  # fmt: skip


def losses_table(summary: RobustnessResult) -> Table:
    """Common properties of lost plants, the strongest first."""
    rows: list[list[Value]] = []
    for case in summary.cases:
        losses, name = case.losses or Losses(lost_plants=0, kept_plants=0), case_title(case)
        counts = f"{losses.lost_plants} / {losses.kept_plants}"
        if losses.effects is None:
            rows.append([name, "too few lost or kept plants", None, None, counts])
            continue
        for one in losses.effects[:_SHOWN_EFFECTS]:
            effect = f"{one.effect:+.2f}"
            rows.append([name, one.quantity, effect, losses.chance_level, counts])
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
