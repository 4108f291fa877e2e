"""The page of a sweep, built from its summary alone."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable
from typing import Any

from deploy.reports.figures import study_figures
from deploy.reports.figures.study_figures import Curve, DrawnStudy, StudyQuantity
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead, level_of
from deploy.reports.studies.study_result import Runs
from deploy.reports.studies.study_texts import number_of, remedy_text
from deploy.scenario.study_keys import LAW
from deploy.studies.sweep.figures import heat_map
from deploy.studies.sweep.result import Axis, Point, SweepResult
from deploy.studies.sweep.tables import point_table
from deploy.study.statistics import NO_EFFECT
from deploy.study.study import shown_value

_MOST_CURVES = 14
_MOST_HEAT_MAPS = 6
QUANTITIES = [study_figures.TICKS_OUTSIDE, study_figures.WORST_RMS]
"""Quantities that the page of every sweep draws."""


def sweep_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """The report of a sweep."""
    summary = SweepResult.model_validate(study.summary)
    points = summary.points
    every = range(len(summary.axes))
    kept = sum(point.runs_kept == point.runs for point in points)
    warnings = [f"warning: {keys}: {NO_EFFECT}" for keys in summary.without_effect]
    helped = _remedies(summary)
    return Page(
        "sweep",
        summary.name,
        verdict=ReportHead(
            level_of(kept, len(points)),
            f"{kept} of {len(points)} points kept their bounds in every run",
            [_swept(summary.axes), *helped, *warnings],
            printed=helped + warnings,
        ),
        facts=[
            Fact("Sweep", summary.name),
            Fact("Scenario", summary.scenario),
            *([Fact("Plants", f"{summary.plants}")] if summary.plants else []),
        ],
        panels=lambda: [*_curve_panels(summary), *_heat_map_panels(summary)],
        subject=study,
        results=[Cards([point_table(summary)], "stacked")],
        points=[
            (_given(summary, point, every) or "all", point.worst_point, study.rerun_worst(point))
            for point in points
        ],
    )


def _swept(axes: Iterable[Axis]) -> str:
    """Name all keys of a sweep with their values, in one sentence."""
    texts = (f"{axis.title} = {', '.join(map(shown_value, axis.values))}" for axis in axes)
    return f"Swept: {'; '.join(texts)}."


def _remedies(summary: SweepResult) -> list[str]:
    """Name what helps each law at the points that it lost, where that is known."""
    place = next((n for n, axis in enumerate(summary.axes) if LAW in axis.keys), None)
    own = summary.conditions.get("law", "")
    laws = {own} if place is None else {str(point.values[place]) for point in summary.points}
    lost = Counter[tuple[str, str, str]]()
    for point in summary.points:
        law = own if place is None else str(point.values[place])
        if point.losses and (remedy := remedy_text(point.losses, law, laws)):
            reason = max(point.losses, key=lambda each: point.losses[each])
            lost[law, reason, remedy] += 1
    return [
        f"{law} is lost at {number_of(count, 'point')} ({reason}): {remedy}."
        for (law, reason, remedy), count in lost.items()
    ]


def _curve_panels(summary: SweepResult) -> list[Panel[DrawnStudy]]:
    """Every quantity over the numeric key with the most values, a line for each of the others."""
    order = _by_size(summary)
    if not order:
        return []
    x = next((axis for axis in order if _is_sequence(summary.axes[axis])), order[0])
    is_sequence = _is_sequence(summary.axes[x])
    lines: dict[str, list[Point]] = {}
    for point in summary.points:
        others = [axis for axis in order if axis != x]
        lines.setdefault(_given(summary, point, others) or "all runs", []).append(point)
    caption = "Means over all runs; shades or bars reach from the best run to the worst."
    if summary.plants:
        caption = caption[:-1] + "; for plants kept, shares with Wilson's 95 % intervals."
    if len(lines) > _MOST_CURVES:
        caption += f" {_MOST_CURVES} of {len(lines)} lines are drawn; all points are in the table."
    shown = [
        Curve(name, index % 7, index // 7, [(runs.values[x], runs) for runs in points],
              is_sequence=is_sequence)
        for index, (name, points) in enumerate(itertools.islice(lines.items(), _MOST_CURVES))
    ]  # fmt: skip
    x_title = summary.axes[x].title
    quantities = _quantities(summary)

    def panel(quantity: StudyQuantity) -> Panel[DrawnStudy]:
        return Panel(
            "First" if quantity is quantities[0] else "Curves", f"curve-{quantity.key}",
            quantity.title,
            lambda study: study_figures.curves(study, shown, x_title, quantity),
            caption, is_clickable=True,
        )  # fmt: skip

    return list(map(panel, quantities))


def _heat_map_panels(summary: SweepResult) -> list[Panel[DrawnStudy]]:
    """Every quantity over the two keys with the most values, a map for each of the others."""
    order = _by_size(summary)[:2]
    if len(order) < 2:
        return []
    others = [axis for axis in range(len(summary.axes)) if axis not in order]
    combinations = itertools.product(*(summary.axes[axis].values for axis in others))
    x, y = ((summary.axes[axis].title, summary.axes[axis].values) for axis in order)

    def places(chosen: tuple[Any, ...]) -> list[list[Runs | None]]:
        """The points of a map, a row per value of `y`."""
        found = {
            tuple(point.values[axis] for axis in order): point
            for point in summary.points
            if chosen == tuple(point.values[axis] for axis in others)
        }
        return [[found.get((a, b)) for a in x[1]] for b in y[1]]

    def panel(index: int, chosen: tuple[Any, ...], quantity: StudyQuantity) -> Panel[DrawnStudy]:
        worse_or_better = "worse" if quantity.more_is_worse else "better"
        return Panel(
            "Heat maps", f"field-{quantity.key}-{index}",
            " · ".join([quantity.title, *summary.named(others, chosen)]),
            lambda study: heat_map(study, x, y, places(chosen), quantity),
            f"Means over all runs; the darker, the {worse_or_better}.",
            is_clickable=True,
        )  # fmt: skip

    return [
        panel(index, chosen, quantity)
        for index, chosen in enumerate(itertools.islice(combinations, _MOST_HEAT_MAPS))
        for quantity in _quantities(summary)
    ]


def _quantities(summary: SweepResult) -> list[StudyQuantity]:
    """Return the quantities to draw as curves and heat maps; those that are all zero last."""
    found = [*([study_figures.PLANTS_KEPT] if summary.plants else []), *QUANTITIES]
    return sorted(found, key=lambda each: not any(each.value(p, "mean") for p in summary.points))


def _given(summary: SweepResult, point: Point, axes: Iterable[int]) -> str:
    """Return the values of a point on some axes, each with its keys."""
    places = list(axes)
    return ", ".join(summary.named(places, [point.values[axis] for axis in places]))


def _by_size(summary: SweepResult) -> list[int]:
    """Axes with more than one value, the longest first."""
    sizes = {index: len(axis.values) for index, axis in enumerate(summary.axes)}
    return sorted((axis for axis in sizes if sizes[axis] > 1), key=lambda axis: -sizes[axis])


def _is_sequence(axis: Axis) -> bool:
    """Whether a line may join the values of an axis: numbers, but not windows or seeds."""
    is_drawn = all(key.endswith(("start_s", "seed")) for key in axis.keys)
    return not is_drawn and all(isinstance(value, float) for value in axis.values)
