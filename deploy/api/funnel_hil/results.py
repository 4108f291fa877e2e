"""Results of runs: numbers, arrays, data frames and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InputError, did_you_mean, needs_extra
from bus_schema.messages import topics
from deploy.judge.run_data import RunData, Table
from deploy.judge.run_rows import Row, row
from deploy.judge.time_series import SERIES, TRACKING, Columns, series
from deploy.judge.verdict import Verdict
from deploy.reports.figures.style import template
from deploy.reports.page import Panel
from deploy.reports.results import Results
from deploy.reports.runs.run_panels import LAW_PANELS, RECORDED_PANELS, panels_of_run
from deploy.run.execute import JudgedRun
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.comparison.recorded import RecordedRuns

if TYPE_CHECKING:
    import pandas as pd


class Drawn:
    """Base of results that have the figures of a report.

    Args:
        panels: the figures.
        shown: what they show.
    """

    def __init__(self, panels: Sequence[Panel[Any]], shown: Any) -> None:
        self._panels = {panel.id: panel for panel in panels}
        self._shown = shown

    @property
    def figure_names(self) -> list[str]:
        """The figures of the report."""
        return list(self._panels)

    def figure(self, name: str) -> go.Figure:
        """A figure of the report.

        Raises:
            InputError: there is none of that name, or there is nothing to draw in it.
        """
        figure = self._panels[_known(name, self.figure_names, "figure")].draw(self._shown)
        if not isinstance(figure, go.Figure):
            raise InputError(f"figure {name!r}: there is nothing to draw")
        return figure.update_layout(template=template())


class _Table(Drawn):
    """Runs that are rows of a table, with the figures of a report.

    Attributes:
        rows: one for each run.
    """

    rows: list[Row]

    def frame(self) -> pd.DataFrame:
        """The rows as a data frame; needs pandas."""
        return _frame(self.rows)


class Run(Drawn):
    """One run.

    Names end in their unit: ``errors_rad``, ``times_s``, ``torques_nm``. Margins are fractions of
    the bound: 1 at zero error, 0 at the bound, negative outside.

    Attributes:
        data: all that was recorded, as the program has it.
        summary: the content of ``summary.json``. Lists have one entry for each joint. Sections:
            ``bounds`` (``margin_min``, ``margin_min_joint``, ``margin_min_s``, ``margin_start``,
            ``margin_steady``, ``violation_fraction``, ``first_violation_s``);
            ``tracking`` (``joint_names``, ``rms_rad``, ``max_abs_rad``, ``settling_time_s``,
            ``settling_bound_s``);
            ``torque`` (``rms_nm``, ``peak_nm``, ``total_variation_nm_per_s``,
            ``share_above_50_hz``, ``saturated_fraction``);
            ``timing`` (``on_time_rate``: share of deadlines met; ``late_ticks``: the other ticks;
            ``round_trip_us``, ``command_age_us`` and so on, each with ``p50`` to ``max``).
            The page *Results* of the documentation lists all others.
        path: its folder or MCAP file; None where it was not written.
    """

    def __init__(self, run: JudgedRun) -> None:
        self.data: RunData = run.data
        self._result, self.summary = run.result, run.summary
        self.path: Path | None = run.path
        super().__init__(panels_of_run(), ComparedRuns([JudgedRun(self.law, run.data, run.result)]))

    def __repr__(self) -> str:
        return f"<Run of {self._result.scenario}, {self.law}: {self.verdict}>"

    @property
    def law(self) -> str:
        """Name of the law."""
        return self._result.law

    @property
    def verdict(self) -> str:
        """``kept``, ``lost``, ``unknown``, ``faulted``, ``interrupted`` or ``nothing``."""
        return self._result.verdict.value

    @property
    def kept(self) -> bool:
        """Whether the run came to its end without a fault, and no error left the funnel."""
        return self.verdict == Verdict.KEPT

    @property
    def margin(self) -> float | None:
        """Smallest ``1 − |e| / bound`` of all joints and ticks; None if nothing was recorded."""
        return self._result.bounds.margin_min

    @property
    def steady_margin(self) -> float | None:
        """The same from ``metrics.from_s`` on; None if the run was over before."""
        return self._result.bounds.margin_steady

    @property
    def faults(self) -> list[str]:
        """Faults of the run, a sentence each."""
        return list(self._result.faults)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.data.setup.robot.joint_names

    @property
    def times_s(self) -> Vector:
        """Begin of each tick of the plant, and the end of the run, shape (ticks + 1,)."""
        return self.data.times_s(topics.PLANT_TRUTH)

    @property
    def errors_rad(self) -> Matrix:
        """True joint errors at `times_s`, shape (ticks + 1, joints)."""
        return self.data.true_errors_rad

    @property
    def torques_nm(self) -> Matrix:
        """Torque on the joints at `times_s`, shape (ticks + 1, joints)."""
        torques: Matrix = self.table(topics.PLANT_TRUTH.name)["torque"]
        return torques

    def table(self, topic: str) -> Table:
        """Messages of a topic as a structured array, shape (messages,)."""
        return self.data.tables[_known(topic, list(self.data.tables), "topic")]

    def series(self, name: str = TRACKING) -> Columns:
        """Arrays by name, with ``time_s``: see `series_names`; ``tracking`` is what is judged."""
        return series(self.data, _known(name, self.series_names, "series"))

    @property
    def series_names(self) -> list[str]:
        return list(SERIES)

    def frame(self, name: str = TRACKING) -> pd.DataFrame:
        """A series as a data frame over ``time_s``; needs pandas."""
        return _frame(self.series(name)).set_index("time_s")

    def figure(self, name: str = "error-in-funnel") -> go.Figure:
        return super().figure(name)


class _SideBySide(_Table):
    """Runs by what tells one from the others."""

    _key: ClassVar[str]

    def __init__(self, panels: Sequence[Panel[Any]], compared: ComparedRuns) -> None:
        super().__init__(panels, compared)
        self.runs = {run.law: Run(run) for run in compared.runs}
        self.rows = [row(run.result, run.seed) for run in compared.runs]

    def __getitem__(self, name: str) -> Run:
        return self.runs[_known(name, list(self.runs), self._key)]

    def figure(self, name: str = "errors") -> go.Figure:
        return super().figure(name)


class Comparison(_SideBySide):
    """Runs of one scenario under several laws.

    Attributes:
        runs: by law.
        rows: one for each law, as in ``comparison.parquet``.
    """

    _key = "law"

    def __init__(self, compared: ComparedRuns) -> None:
        super().__init__(LAW_PANELS, compared)


class Diff(_SideBySide):
    """Recorded runs, compared with the first of them.

    Attributes:
        runs: by label, the shortest ends of their paths that tell them apart.
        rows: one for each run, with its label as ``run``.
        differing: values of the scenarios by run, as JSON, for each key that is not the same.
        first_different_ticks: by label of each run but the first: the first tick at which position,
            velocity or torque are not the same bits; None where they are throughout,
            as far as both recordings have them.
    """

    _key = "run"

    def __init__(self, compared: RecordedRuns) -> None:
        super().__init__(RECORDED_PANELS, compared)
        self.rows = [
            {"run": label, **each} for label, each in zip(self.runs, self.rows, strict=True)
        ]
        self.differing = compared.differing
        ticks = [None if each is None else each.tick for each in compared.partings]
        self.first_different_ticks = dict(zip(compared.labels[1:], ticks[1:], strict=True))


class Study(_Table):
    """Result of a sweep or of margins.

    Attributes:
        summary: what ``summary.json`` says.
        rows: one for each run.
    """

    def __init__(self, results: Results, rows: Sequence[Row]) -> None:
        page = results.page
        super().__init__([] if page is None else list(page.panels()), page and page.subject)
        self.summary, self.rows = results.summary, list(rows)

    def __repr__(self) -> str:
        return f"<Study {self.summary['name']}, {self.summary['kind']}: {len(self.rows)} runs>"

    @property
    def margins(self) -> dict[str, float | None]:
        """The margin to quote by law, where this is a study of margins with one case a law."""
        cases: list[dict[str, Any]] = self.summary.get("cases", [])
        found = {case["law"]: case["quoted"] for case in cases if "quoted" in case}
        if len(found) < len(cases) or not cases:
            raise InputError("margins: must be asked of margins with one case a law; see summary")
        return found


def _known(name: str, names: Sequence[str], what: str) -> str:
    if name not in names:
        allowed = f"must be one of {', '.join(names)}{did_you_mean(name, names)}"
        raise InputError(f"{what} {name!r}: {allowed}")
    return name


def _frame(columns: Mapping[str, Any] | Sequence[Row]) -> pd.DataFrame:
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError(f"a data frame {needs_extra('pandas', 'frames')}") from error
    return pd.DataFrame(columns)
