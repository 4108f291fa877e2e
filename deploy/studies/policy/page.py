"""The page of a policy: how long its inference may take, and how its chunks jump."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from deploy.reports.figures import style
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.studies.study_tables import TableColumn
from deploy.reports.tables import ABSENT, Cell, Column, Table, number, scaled, table_of
from deploy.studies.policy.findings import jump_column, longest, recommended

Summary = Mapping[str, Any]
_HEIGHT_PX = 430


def policy_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """Return the report of a policy."""
    summary = study.summary
    first, *more = [each for arm in _arms(summary) for each in advice(summary, arm)]
    return Page(
        "policy",
        summary["name"],
        verdict=ReportHead("mixed", first.rstrip("."), more),
        facts=[
            Fact("Policy", summary["policy"]),
            Fact("Network", summary["network"] or "that of the scenario"),
            Fact("Tasks", str(summary["tasks"] or "that of the scenario")),
        ],
        panels=lambda: [_panel(index, arm) for index, arm in enumerate(_arms(summary))],
        subject=study,
        results=[Cards([policy_table(summary)], "stacked")],
        points=[
            (f"{case['arm']}, {case['merge']}, {point['inference_ms']:g} ms",
             point["worst_point"], study.rerun(point["worst_point"]))
            for case in summary["cases"] for point in case["points"]
        ],
        quoted=lambda: policy_table(summary),
    )  # fmt: skip


def advice(summary: Summary, arm: str) -> list[str]:
    """Return the recommended setting for an arm in one sentence, and what it rests on."""
    cases = [case for case in summary["cases"] if case["arm"] == arm]
    if not summary["completed"]:
        return [f"{arm}: not complete."]
    best = recommended(cases)
    if best is None:
        return [f"{arm}: no merge keeps the bounds, even without inference time."]
    at, key = best["at"], jump_column(cases)
    jump = _jump(at, key)
    most = [_jump(case["at"], key) for case in cases if case["at"] and case is not best]
    others = f", where others jump by up to {max(most)[1]}" if most and max(most) > jump else ""
    last = longest(cases)
    more = ""
    if last["inference_ms"] > best["inference_ms"]:
        more = f"; {last['merge']} keeps them longest, up to {_up_to(last)}"
    return [
        f"{arm}: at an inference time of {at['inference_ms']:g} ms use {best['merge']}.",
        f"Its chunks jump by {jump[1]}{others}. It keeps the bounds up to {_up_to(best)}{more}.",
    ]


def _up_to(case: Summary) -> str:
    text = f"{case['inference_ms']:g} ms"
    if not case["is_limit"]:
        return text
    return f"{text} (the largest {'tried' if case['is_whole'] else 'for which it is defined'})"


def _jump(point: Summary, key: str) -> tuple[float, str]:
    """Return a jump at the tip or of a joint, by the column, and its text."""
    if key == "jump_mm":
        return point[key], f"{number(point[key])} mm"
    mrad = scaled(point[key], style.MRAD) or 0.0
    return mrad, f"{number(mrad)} mrad"


def policy_table(summary: Summary) -> Table:
    """Return the merges of each arm, a row each."""
    best = [recommended([c for c in summary["cases"] if c["arm"] == a]) for a in _arms(summary)]

    def at(key: str, factor: float = 1.0) -> Callable[[Summary], float | None]:
        return lambda case: scaled((case["at"] or {}).get(key), factor)

    def largest(case: Summary) -> str | float | None:
        time_ms = case["inference_ms"]
        return f"≥ {time_ms:g}" if case["is_limit"] and case["is_whole"] else time_ms

    def ends(case: Summary) -> str:
        if case["is_limit"] and not case["is_whole"]:
            return "d > H − s"
        return case["ends"] or ABSENT

    def tasks(case: Summary) -> str:
        found = case["of_tasks_ms"]
        times = (found[name] for name in ("smallest", "median", "largest"))
        return " · ".join(ABSENT if each is None else f"{each:g}" for each in times)

    columns: list[TableColumn] = [
        (Column("Arm", is_text=True), lambda case: case["arm"]),
        (Column("Merge", is_text=True),
         lambda case: Cell(case["merge"], "best" if case in best else "")),
        (Column("Largest inference", "ms", "Largest\ninference"), largest),
        *([(Column("Of tasks: least · median · most", "ms", "Of tasks"), tasks)]
          if all(case["of_tasks_ms"] for case in summary["cases"]) else []),
        (Column("Ends by", is_text=True, brief="Ends\nby"), ends),
        (Column("Largest jump", "mrad", "Jump"), at("jump_rad", 1e3)),
        (Column("At the tip", "mm", "At the\ntip"), at("jump_mm")),
        (Column("Jerk, largest", "rad/s³", "Jerk"), at("jerk_rad_s3")),
        (Column("Jerk, RMS", "rad/s³", "RMS"), at("jerk_rms_rad_s3")),
        (Column("Age, median", "ms", None), at("age_median_ms")),
        (Column("Age, largest", "ms", "Age"), at("age_largest_ms")),
        (Column("Waiting", "%"), at("starved_share", 100.0)),
        (Column("Tip error, RMS", "mm", "Tip\nerror"), at("tip_error_rms_mm")),
    ]  # fmt: skip
    note = (
        f"Largest inference times are up to {summary['limit_ms']:g} ms, on a grid; jumps, jerk,"
        f" ages, waiting and errors are those at {summary['at_ms']:g} ms, the largest of its runs."
    )
    return table_of(f"{summary['policy']}: merges of chunks", columns, summary["cases"], note)


def _arms(summary: Summary) -> list[str]:
    return list(dict.fromkeys(case["arm"] for case in summary["cases"]))


def _panel(index: int, arm: str) -> Panel[DrawnStudy]:
    return Panel(
        "First", f"jumps-{index}", f"{arm}: jumps and jerk over the inference time",
        lambda study: _figure(study, arm),
        "One line for each merge; a cross marks inference times at which the bounds were lost.",
        is_clickable=True,
    )  # fmt: skip


def _figure(study: DrawnStudy, arm: str) -> go.Figure:
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    cases = [case for case in study.summary["cases"] if case["arm"] == arm]
    is_tip = any(point["jump_mm"] for case in cases for point in case["points"])
    jump, factor, unit = ("jump_mm", 1.0, "mm") if is_tip else ("jump_rad", style.MRAD, "mrad")
    shown = (
        (jump, factor, f"largest jump ({unit})"),
        ("jerk_rms_rad_s3", 1.0, "jerk, RMS (rad/s³)"),
    )
    for column, (key, scale, title) in enumerate(shown, 1):
        for index, case in enumerate(cases):
            points = case["points"]
            lost = [each["runs_kept"] < each["runs"] for each in points]
            figure.add_scatter(
                x=[each["inference_ms"] for each in points],
                y=[scaled(each[key], scale) for each in points],
                customdata=[study.rerun(each["worst_point"]) for each in points],
                name=case["merge"], legendgroup=case["merge"], showlegend=column == 1,
                mode="lines+markers", line={"color": style.palette(index)},
                marker={"symbol": ["x" if each else "circle" for each in lost], "size": 8},
                row=1, col=column,
            )  # fmt: skip
        figure.update_yaxes(title=title, rangemode="tozero", row=1, col=column)
        figure.update_xaxes(title="inference time (ms)", row=1, col=column)
    style.apply(figure, _HEIGHT_PX)
    return figure.update_layout(showlegend=True, legend_orientation="h", legend_y=1.15)
