"""The page of a policy: how long its inference may take, and how its chunks jump."""

from __future__ import annotations

from collections.abc import Callable

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from deploy.judge.findings.loss_reason import Reason
from deploy.judge.findings.remedies import remedy_of
from deploy.reports.figures import style
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.study_tables import TableColumn, shown_columns
from deploy.reports.tables import ABSENT, Cell, Column, Table, number, scaled, table_of
from deploy.studies.policy.findings import jump_column, longest, recommended
from deploy.studies.policy.result import Merge, Point, PolicyResult

_HEIGHT_PX = 430
_HELPS: dict[str, str] = {
    Reason.RAN_OUT: "Answers take longer than a chunk lasts: try a longer horizon"
    " (controller.chunks.horizon), or ask earlier (controller.chunks.ask_every)",
    Reason.VIBRATION: "Compare the velocities in the answers with the slope of the positions, and"
    " how far the policy sees ahead with the age of its answers; or make the robot's loop softer",
}
"""What helps a policy in particular, by the reason why it does not hold."""
_LOOP = (
    "A late torque acts on a state that has changed: try a drive loop"
    " (controller.drive_feedback.enabled=true), or a robot interface of positions"
    " (plant.interface.kind=servoj)"
)
"""What helps arms that get torques over a network."""
_MERGE_LIMIT = "limit of the merge"
_FAR_OUTSIDE = 3.0
"""Times its bound from which an error is no matter of a wider bound."""


def policy_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """Return the report of a policy."""
    result = PolicyResult.model_validate(study.summary)
    first, *more = [each for arm in result.arms for each in advice(result, arm, study.rerun)]
    return Page(
        "policy",
        result.name,
        verdict=ReportHead("mixed", first.rstrip("."), more),
        facts=[
            Fact("Policy", result.policy),
            Fact("Network", result.network or "that of the scenario"),
            Fact("Tasks", str(result.tasks or "that of the scenario")),
        ],
        panels=lambda: [_panel(i, arm, own) for i, (arm, own) in enumerate(result.arms.items())],
        subject=study,
        results=[Cards([policy_table(result)], "stacked")],
        points=[
            (f"{case.arm}, {case.merge}, {point.inference_ms:g} ms",
             point.worst_point, study.rerun(point.worst_point))
            for case in result.cases for point in case.points
        ],
        quoted=lambda: policy_table(result),
    )  # fmt: skip


def advice(result: PolicyResult, arm: str, rerun: Callable[[str], str]) -> list[str]:
    """Return the recommended setting for an arm in one sentence, and what it rests on.

    Args:
        result: the result.
        arm: the arm.
        rerun: returns the command that repeats a point.
    """
    cases = result.arms[arm]
    if not result.completed:
        return [f"{arm}: not complete."]
    best = recommended(cases)
    if best is None or best.at is None:
        reasons = _first_ends(cases)
        network = _without_network(result, arm)
        helps = _helps(reasons, result, arm) or network[1:] or _what_to_change(cases, rerun)
        first = f"{arm}: {_none_holds(cases, reasons)}."
        return [first, *network[:1], *_least_used(cases), *helps]
    if (best.inference_ms or 0.0) < best.at.inference_ms:
        why = f" ({best.ends})" if best.ends else ""
        is_kept = any(case.at and case.at.runs_kept == case.at.runs for case in cases)
        flaw = "bounds are kept but no merge holds" if is_kept else "no merge keeps the bounds"
        return [
            f"{arm}: {best.merge} holds longest, up to {_up_to(best)} of inference. At"
            f" {best.at.inference_ms:g} ms {flaw}{why}.",
            *_helps([best.ends] if best.ends else [], result, arm),
        ]
    key, last = jump_column(cases), longest(cases)
    jump = _jump(best.at, key)
    most = [_jump(case.at, key) for case in cases if case.at and case is not best]
    others = f", where others jump by up to {max(most)[1]}" if most and max(most) > jump else ""
    more = f"; {last.merge} keeps them longest, up to {_up_to(last)}"
    more *= last.inference_ms != best.inference_ms
    return [
        f"{arm}: at an inference time of {best.at.inference_ms:g} ms use {best.merge}.",
        f"Its chunks jump by {jump[1]}{others}. It keeps the bounds up to {_up_to(best)}{more}.",
    ]


def _helps(reasons: list[str], result: PolicyResult, arm: str) -> list[str]:
    """Return what helps against reasons of a loss, a sentence each."""
    known = _HELPS | (dict[str, str]({Reason.LATE: _LOOP}) if arm in result.torque_arms else {})
    remedies = (known.get(reason) or remedy_of(reason, result.policy) for reason in reasons)
    return [f"{each[0].upper()}{each[1:]}." for each in remedies if each]


def _without_network(result: PolicyResult, arm: str) -> list[str]:
    """Return what becomes of a run without the network, and what helps where that is the cause."""
    for each in result.without_network:
        if each.arm == arm and each.held:
            cause = f"Without {result.network}, {each.merge} holds: the network is the cause."
            return [cause, *([f"{_LOOP}."] if arm in result.torque_arms else [])]
        if each.arm == arm:
            why = f" ({each.ends})" if each.ends else ""
            return [f"Without {result.network}, {each.merge} does not hold either{why}."]
    return []


def _first_ends(cases: list[Merge]) -> list[str]:
    """Return why runs at the shortest inference time do not hold, by all their reasons."""
    points = [point for case in cases for point in case.points]
    shortest_ms = min(point.inference_ms for point in points)
    return sorted({p.ends for p in points if p.inference_ms == shortest_ms and p.ends})


def _none_holds(cases: list[Merge], reasons: list[str]) -> str:
    """Return what becomes of the shortest inference time, which no merge tolerates."""
    points = [point for case in cases for point in case.points]
    shortest_ms = min(point.inference_ms for point in points)
    kept_ms = sorted({point.inference_ms for point in points if point.runs_kept == point.runs})
    why = f" ({', '.join(reasons)})" if reasons else ""
    if not kept_ms:
        return f"no merge keeps the bounds, even at an inference time of {shortest_ms:g} ms{why}"
    flaw = "bounds are kept but it does not hold" if kept_ms[0] == shortest_ms else "it is lost"
    longer = [each for each in kept_ms if each > shortest_ms]
    more = f"; bounds are kept at up to {longer[-1]:g} ms, see the figure" if longer else ""
    return f"no inference time to quote: at {shortest_ms:g} ms {flaw}{why}{more}"


def _least_used(cases: list[Merge]) -> list[str]:
    """Return how far the error goes at the shortest inference time, with the merge of the least."""
    firsts = {case.merge: case.points[0] for case in cases}
    known = {name: each.bound_used for name, each in firsts.items() if each.bound_used is not None}
    if not known:
        return []
    merge = min(known, key=lambda name: known[name])
    tip_mm = firsts[merge].tip_error_rms_mm
    tip = f", {number(tip_mm)} mm at the tip (RMS)" if tip_mm else ""
    return [f"There, the error with {merge} reaches {number(known[merge])} times its bound{tip}."]


def _what_to_change(cases: list[Merge], rerun: Callable[[str], str]) -> list[str]:
    """Return what to do about a loss at the shortest inference time, if no reason says so."""
    used = min((case.points[0].bound_used or 0.0 for case in cases), default=0.0)
    if used <= 1.0:
        return []
    if used < _FAR_OUTSIDE:
        return ["If your task allows that error, widen the bound: --set funnel.final_rad=…."]
    point = cases[0].points[0].worst_point
    return [f"To see the policy's answers in the report of one run: {rerun(point)}"]


def _up_to(case: Merge) -> str:
    text = f"{case.inference_ms:g} ms"
    if not case.is_limit:
        return text
    return f"{text} (the largest {'tried' if case.is_whole else 'for which it is defined'})"


def _jump(point: Point, key: str) -> tuple[float, str]:
    """Return a jump at the tip or of a joint, by the column, and its text."""
    size, unit = (point.jump_mm, "mm") if key == "jump_mm" else (_mrad(point), "mrad")
    return size or 0.0, f"{number(size)} {unit}"


def _mrad(point: Point) -> float:
    return scaled(point.jump_rad, style.MRAD) or 0.0


def policy_table(result: PolicyResult) -> Table:
    """Return the merges of each arm, a row each."""
    best = [recommended(cases) for cases in result.arms.values()]

    def largest(case: Merge) -> str | float | None:
        return f"≥ {case.inference_ms:g}" if case.is_limit and case.is_whole else case.inference_ms

    def ends(case: Merge) -> str:
        return _MERGE_LIMIT if _is_merge_limit(case) else case.ends or ABSENT

    def tasks(case: Merge) -> str:
        found = case.of_tasks_ms
        times = (found.smallest, found.median, found.largest) if found else ()
        return " · ".join(ABSENT if each is None else f"{each:g}" for each in times)

    columns: list[TableColumn] = [
        (Column("Arm", is_text=True), lambda case: case.arm),
        (Column("Merge", is_text=True),
         lambda case: Cell(case.merge, "best" if case in best else "")),
        (Column("Largest inference", "ms", "Longest\ntime"), largest),
        *([(Column("Of tasks: least · median · most", "ms", "Of tasks"), tasks)]
          if all(case.of_tasks_ms for case in result.cases) else []),
        (Column("Ends by", is_text=True, brief="Ends\nby"), ends),
        *shown_columns(Point, lambda case: case.at),
    ]  # fmt: skip
    note = (
        f"Largest inference times are up to {result.limit_ms:g} ms, on a grid; jumps, jerk,"
        f" ages, waiting and errors are those at {result.at_ms:g} ms, the largest of its runs."
    )
    if any(map(_is_merge_limit, result.cases)):
        note += (
            f" {_MERGE_LIMIT[0].upper()}{_MERGE_LIMIT[1:]}: a longer inference leaves too few"
            " actions of a chunk to go over to the next one."
        )
    return table_of(f"{result.policy}: merges of chunks", columns, result.cases, note)


def _is_merge_limit(case: Merge) -> bool:
    return case.is_limit and not case.is_whole


def _panel(index: int, arm: str, cases: list[Merge]) -> Panel[DrawnStudy]:
    return Panel(
        "First", f"jumps-{index}", f"{arm}: jumps and jerk over the inference time",
        lambda study: _figure(study, cases),
        "One line for each merge; a cross marks inference times at which the bounds were lost.",
        is_clickable=True,
    )  # fmt: skip


def _figure(study: DrawnStudy, cases: list[Merge]) -> go.Figure:
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    is_tip = any(point.jump_mm for case in cases for point in case.points)
    jump, factor, unit = ("jump_mm", 1.0, "mm") if is_tip else ("jump_rad", style.MRAD, "mrad")
    shown = (
        (jump, factor, f"largest jump ({unit})"),
        ("jerk_rms_rad_s3", 1.0, "jerk, RMS (rad/s³)"),
    )
    for column, (key, scale, title) in enumerate(shown, 1):
        for index, case in enumerate(cases):
            points = case.points
            lost = [each.runs_kept < each.runs for each in points]
            figure.add_scatter(
                x=[each.inference_ms for each in points],
                y=[scaled(getattr(each, key), scale) for each in points],
                customdata=[study.rerun(each.worst_point) for each in points],
                name=case.merge, legendgroup=case.merge, showlegend=column == 1,
                mode="lines+markers", line={"color": style.palette(index)},
                marker={"symbol": ["x" if each else "circle" for each in lost], "size": 8},
                row=1, col=column,
            )  # fmt: skip
        figure.update_yaxes(title=title, rangemode="tozero", row=1, col=column)
        figure.update_xaxes(title="inference time (ms)", row=1, col=column)
    style.apply(figure, _HEIGHT_PX)
    return figure.update_layout(showlegend=True, legend_orientation="h", legend_y=1.15)
