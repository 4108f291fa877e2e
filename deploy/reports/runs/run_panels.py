"""The figures of reports of runs: of one run, of several laws, of recorded runs side by side.

``templates/panels.yaml`` has their order and texts, this module the function that draws each.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib import resources
from typing import Any, TypeAlias, TypeVar

import plotly.graph_objects as go

from bus_schema.registry import Registry
from deploy.judge.run_data import RunData
from deploy.reports.figures import chunks, joints, learned, link, several_runs, space, timeline
from deploy.reports.figures.arm_pictures import arm_pictures
from deploy.reports.page import Content, Panel
from deploy.reports.runs import run_numbers
from deploy.scenario.yaml_text import values_of
from deploy.study.comparison.compared_runs import ComparedRuns

logger = logging.getLogger(__name__)
T = TypeVar("T")
RunsPanel = Panel[ComparedRuns]
Draw: TypeAlias = "Callable[[ComparedRuns], Content | Callable[[], Content | None] | None]"


def _of_run(draw: Callable[[RunData], T]) -> Callable[[ComparedRuns], T]:
    """Return a function that draws the first run, for a report of one."""
    return lambda runs: draw(runs.runs[0].data)


def _bars(quantity: run_numbers.JointQuantity) -> Draw:
    return partial(several_runs.joint_bars, quantity=quantity)


_ONE_RUN: dict[str, Draw] = {
    "timeline": _of_run(timeline.timeline),
    "error-in-funnel": joints.error_in_funnel,
    "chunks": _of_run(chunks.chunks_over_time),
    "delay-over-time": link.delay_over_time,
    "error-first-second": joints.error_first_second,
    "error-envelopes": joints.error_envelopes,
    "transformed-error": _of_run(joints.transformed_error),
    "torques": _of_run(joints.torques),
    "tip-path": space.tip_path,
    "tip-error": _of_run(space.tip_error),
    "arm-motion": _of_run(space.arm_motion),
    "arm": _of_run(arm_pictures),
    "network-output": learned.network_output,
    "learned-values": _of_run(learned.learned_values),
    "learned-inertia": _of_run(partial(learned.learned_over_time, key="inertia_factor")),
    "learned-payload": _of_run(partial(learned.learned_over_time, key="payload_kg")),
    "learned-lag": _of_run(partial(learned.learned_over_time, key="lag_ms")),
    "learned-coulomb": _of_run(partial(learned.learned_over_time, key="coulomb_nm")),
    "learned-viscous": _of_run(partial(learned.learned_over_time, key="viscous_nm_s")),
    "timing-percentiles": _of_run(timeline.times_of_run),
    "deadline-misses": _of_run(timeline.deadline_misses),
    "trace-percentiles": _of_run(link.trace_percentiles),
    "trace-autocorrelation": _of_run(link.trace_autocorrelation),
}
_TIMES: dict[str, Draw] = {
    key.removesuffix("_us").replace("_", "-"): partial(timeline.time_of_runs, key=key)
    for key in run_numbers.TIMES
}
_SEVERAL_RUNS: dict[str, Draw] = {
    "rms": _bars(run_numbers.RMS_ERROR),
    "settling": several_runs.settling,
    "settling-from-afar": several_runs.settling_from_afar,
    "errors": joints.error_in_funnel,
    "errors-first-second": joints.error_first_second,
    "error-envelopes": joints.error_envelopes,
    "positions-apart": joints.positions_apart,
    "tip-paths": space.tip_path,
    "tip-errors": space.tip_error_envelopes,
    "torques": joints.torques_side_by_side,
    "total-variation": _bars(run_numbers.TOTAL_VARIATION),
    "chatter-share": _bars(run_numbers.SHARE_ABOVE_50_HZ),
    "torque-spectra": joints.torque_spectra,
    "network-output": learned.network_output,
    **_TIMES,
}
_FOLDED = {"Events over time", "Timing", "The link compared with its trace"}
_OF_RECORDINGS = {"positions-apart", *_TIMES}
_OF_LAWS = {"settling", "settling-from-afar", "tip-errors", "total-variation", "chatter-share",
            "network-output"}  # fmt: skip


def _panels(texts: Mapping[str, Any], draws: Mapping[str, Draw]) -> list[RunsPanel]:
    """Return panels by id; in those over time but the timeline, scheduled faults are shades."""
    if texts.keys() != draws.keys():
        raise ValueError(f"panels.yaml: must have texts of {', '.join(draws)}, and of no others")
    shaded = {name for name, text in texts.items() if "is_over_time" in text} - {"timeline"}
    return [
        Panel(
            id=name,
            draw=timeline.with_faults(draws[name]) if name in shaded else draws[name],
            is_folded=text["section"] in _FOLDED,
            **text,
        )
        for name, text in texts.items()
    ]


_FILE = resources.files("deploy.reports").joinpath("templates/panels.yaml")
_TEXTS = values_of(_FILE.read_text(encoding="utf-8"))

RUN_PANELS = _panels(_TEXTS["one_run"], _ONE_RUN)
"""The figures of a run that ship."""
RUN_FIGURES: Registry[RunsPanel] = Registry(
    "figures", "figure", Panel, {panel.id: panel for panel in RUN_PANELS}
)
"""The figures of a run by name; installed packages add some."""
_RUNS_PANELS = _panels(_TEXTS["several_runs"], _SEVERAL_RUNS)
LAW_PANELS = [panel for panel in _RUNS_PANELS if panel.id not in _OF_RECORDINGS]
"""The figures of a comparison of laws."""
RECORDED_PANELS = [panel for panel in _RUNS_PANELS if panel.id not in _OF_LAWS]
"""The figures of recorded runs side by side."""


def panels_of_run() -> list[RunsPanel]:
    """Return the figures of a run, those of installed packages last in their sections."""
    added = [
        replace(panel, id=name, draw=partial(_drawn, str(extension), panel.draw))
        for name, panel in RUN_FIGURES.usable().items()
        if (extension := RUN_FIGURES.extension(name)) is not None and isinstance(panel, Panel)
    ]
    return [*RUN_PANELS, *added]


def _drawn(extension: str, draw: Draw, runs: ComparedRuns) -> go.Figure | None:
    """Draw a figure of a package; without one it is left out, so that the report is written."""
    try:
        content = draw(runs)
        if content is not None and not isinstance(content, go.Figure):
            raise TypeError(f"gives a {type(content).__name__}, not a plotly figure")
    except Exception as error:  # noqa: BLE001  code of a package may raise anything
        logger.warning("%s is left out: %s: %s", extension, type(error).__name__, error)
        return None
    return content
