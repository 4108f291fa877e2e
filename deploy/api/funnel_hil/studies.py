"""Many runs: sweeps and margins."""

from __future__ import annotations

import itertools
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from controller.laws.custom import Maker, laws_given
from deploy.judge.run_rows import Row
from deploy.reports.results import write_study
from deploy.run.new_folder import new_folder
from deploy.study.execution.conduct import conduct
from deploy.study.execution.folder import StudyFolder, here
from deploy.study.execution.runner import Workers
from deploy.study.robustness import margin_study
from deploy.study.study import PlannedRun, StudyOfRuns, row_of
from deploy.study.sweep import Sweep
from funnel_hil.results import Study
from funnel_hil.scenarios import Changes, Law, Scenario, ScenarioLike, named_law

OnProgress = Callable[[int, int], None]
"""Is called after each run with how many are done, and how many there will be."""


def sweep(
    scenario: ScenarioLike = "paper_arm",
    grid: Mapping[str, Sequence[Any] | Mapping[str, float]] | None = None,
    changes: Changes | None = None,
    *,
    law: Law | None = None,
    seeds: int | Sequence[int] = 1,
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
    **more: Any,
) -> Study:
    """Run every point of a grid with every seed.

    Args:
        scenario: as for `simulate`.
        grid: values by dotted key, as lists or ``{"from": …, "to": …, "step": …}``; keys that are
            separated by commas take each value together.
        changes: as for `simulate`.
        law: as for `simulate`.
        seeds: how many, or which.
        workers: processes to start on this machine: 0 for none (all is done in this one), None for
            as many as it has cores. A script that starts some needs ``if __name__ == "__main__":``.
        scheduler: address of a Dask scheduler to use instead; anybody who reaches it runs code.
        out: folder for rows, summary and report, in which the same study goes on.
        progress: on_progress of each run.
        more: what else a sweep file may say: ``plants``, ``plant_seed``, ``uncertainty``, ``name``.

    Raises:
        InputError: something about it is wrong.
    """
    given = Scenario(scenario, changes, law)
    values = {"name": "sweep", "grid": dict(grid or {}), "seeds": _seeds(seeds), **more}
    with given.laws():
        return _conducted(
            given, lambda file: Sweep({**values, "scenario": str(file)}, Path("sweep")),
            workers, scheduler, out, progress,
        )  # fmt: skip


def margin(
    scenario: ScenarioLike = "paper_arm",
    changes: Changes | None = None,
    *,
    laws: Sequence[Law] | None = None,
    seeds: int | Sequence[int] = 2,
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
    **more: Any,
) -> Study:
    """Find the largest delay, or anything else, at which each law keeps its bounds.

    Args:
        scenario: as for `simulate`.
        changes: as for `simulate`.
        laws: names, classes or laws; all shipped ones and the scenario's own by default.
        seeds: how many, or which.
        workers: as for `sweep`.
        scheduler: as for `sweep`.
        out: as for `sweep`.
        progress: as for `sweep`.
        more: what else a study of margins may say: ``quantity`` (``delay``, ``jitter``, ``loss``,
            or a dotted key), ``resolution``, ``limit``, ``offsets``, ``compensation``,
            ``drive_feedback``, ``duration_s``, ``pattern`` (``any``), ``disturbances``,
            ``what_helps``, ``smaller_rotors``, ``plants`` with ``values``, and so on.

    Raises:
        InputError: something about it is wrong.
    """
    given = Scenario(scenario, changes)
    values: dict[str, Any] = {"seeds": _seeds(seeds), **more}
    makers: dict[str, Maker] = {}
    if laws is not None:
        named = [named_law(law) for law in laws]
        values["laws"] = [name for name, _ in named]
        makers = {name: make for _, own in named for name, make in own.items()}
    with given.laws(), laws_given(makers):
        return _conducted(
            given, lambda file: margin_study({**values, "scenarios": [str(file)]}, Path("margin")),
            workers, scheduler, out, progress,
        )  # fmt: skip


def _seeds(seeds: int | Sequence[int]) -> int | list[int]:
    return seeds if isinstance(seeds, int) else list(seeds)


class _Here:
    """Does runs in this process, one at a time."""

    count = 1
    current = staticmethod(here)

    def __init__(self) -> None:
        self._waiting: deque[PlannedRun] = deque()

    def submit(self, run: PlannedRun) -> None:
        self._waiting.append(run)

    def finished(self, _timeout_s: float) -> tuple[PlannedRun, Row]:
        run = self._waiting.popleft()
        return run, row_of(run)


def _conducted(
    given: Scenario,
    build: Callable[[Path], StudyOfRuns],
    workers: int | None,
    scheduler: str | None,
    out: str | Path | None,
    on_progress: OnProgress | None,
) -> Study:
    """Conduct a study, and judge it."""
    with ExitStack() as stack:
        place = stack.enter_context(tempfile.TemporaryDirectory()) if out is None else out
        with conducted(given, build, Path(place), workers, scheduler, on_progress) as (
            study,
            folder,
        ):
            return Study(write_study(study, folder), folder.rows)


@contextmanager
def conducted(
    given: Scenario,
    build: Callable[[Path], StudyOfRuns],
    out: Path,
    workers: int | None = 0,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    *,
    overwrite: bool = False,
) -> Iterator[tuple[StudyOfRuns, StudyFolder]]:
    """Conduct a study of a scenario; yield it and its folder, which is locked meanwhile.

    The scenario is written to a file, from which every run reads it.
    """
    done = itertools.count(1)

    def progress(_row: Row, expected: int, _before: bool) -> None:
        if on_progress is not None:
            on_progress(next(done), expected)

    place = out.resolve()
    if overwrite:
        new_folder(given.name, place, overwrite=True)
    place.mkdir(parents=True, exist_ok=True)
    file, text = place / "base" / f"{given.name}.yaml", given.to_yaml()
    if not file.is_file() or file.read_text(encoding="utf-8") != text:
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, encoding="utf-8")
    study = build(file)

    def team() -> AbstractContextManager[Workers]:
        if workers == 0 and scheduler is None:
            return nullcontext(_Here())
        from deploy.study.execution.dask_workers import DaskWorkers  # heavy

        return DaskWorkers(workers or None, scheduler, study.laws)

    with conduct(
        study, team, place, nullcontext(progress), is_elsewhere=scheduler is not None
    ) as ended:
        if ended.lost is not None:
            raise ended.lost
        yield study, ended.folder
