"""Many runs: sweeps, margins, tunings, benchmarks, and kinds of study that packages add."""

from __future__ import annotations

import itertools
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any, Literal

from controller.laws import COMPARED_LAWS, torque_laws
from controller.laws.custom import Maker, laws_given
from deploy.judge.run_rows import Row
from deploy.reports.kinds import study_type
from deploy.reports.studies.results import write_study
from deploy.run.new_folder import new_folder
from deploy.scenario.yaml_files import naming
from deploy.studies.benchmark.benchmark import Benchmark
from deploy.studies.benchmark.cells import BENCHMARK_DELAYS_MS, BENCHMARK_PREDICTORS
from deploy.studies.margin.margin_study import margin_study
from deploy.studies.policy.policy import PolicyStudy
from deploy.studies.sweep.sweep import Sweep
from deploy.study.execution.folder import StudyFolder, here
from deploy.study.execution.runner import Workers
from deploy.study.execution.session import open_session
from deploy.study.planned_run import PlannedRun, row_of
from deploy.study.study import StudyOfRuns
from funnel_hil.results import Study
from funnel_hil.scenarios import Changes, InputError, Law, Scenario, ScenarioLike, named_law

OnProgress = Callable[[int, int], None]
"""Is called after each run with how many are done, and how many there are at most."""

_How = tuple[int | None, str | None, str | Path | None, OnProgress | None]
"""Workers, scheduler, folder and what is called after each run."""


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
    return _result_of(given, values, Sweep, {}, (workers, scheduler, out, progress))


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
        values["laws"], makers = _named_laws(laws)
    return _result_of([given], values, margin_study, makers, (workers, scheduler, out, progress))


def policy(
    law: Law,
    scenarios: Sequence[ScenarioLike] = ("paper_arm",),
    *,
    merges: Sequence[str] | None = None,
    tasks: int | None = None,
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
    **more: Any,
) -> Study:
    """Find how long the inference of a policy may take, with each merge of its chunks.

    Args:
        law: the policy: its name, class, or what makes it.
        scenarios: each as for `simulate`.
        merges: rules by which a new chunk takes over; by default all that do not wait.
        tasks: number of tasks, for a reference that draws them.
        workers: as for `sweep`.
        scheduler: as for `sweep`.
        out: as for `sweep`.
        progress: as for `sweep`.
        more: what else a study of a policy may say: ``network``, ``at_ms``, ``limit_ms``,
            ``resolution_ms``, ``seeds``, ``set``.

    Raises:
        InputError: something about it is wrong.
    """
    [name], makers = _named_laws([law])
    values: dict[str, Any] = {"law": name, "tasks": tasks, **more}
    if merges is not None:
        values["merges"] = list(merges)
    given = list(map(Scenario, scenarios))
    return _result_of(given, values, PolicyStudy, makers, (workers, scheduler, out, progress))


def tune(
    scenario: ScenarioLike = "paper_arm",
    changes: Changes | None = None,
    *,
    laws: Sequence[str] = COMPARED_LAWS,
    goal: Literal["rms", "margin"] = "rms",
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
    **more: Any,
) -> Study:
    """Search for the gains of laws: the same search, budget and runs for each of them.

    Args:
        scenario: as for `simulate`.
        changes: as for `simulate`.
        laws: names of laws.
        goal: ``rms`` for a small error with a smooth torque, ``margin`` for a large delay.
        workers: as for `sweep`.
        scheduler: as for `sweep`.
        out: as for `sweep`; also gets a scenario with the gains of each law.
        progress: as for `sweep`.
        more: what else a tuning may say: ``budget``, ``search_seed``, ``duration_s``,
            ``delays_ms``, ``travel_limit_per_s``, ``ranges``, ``plants``, ``uncertainty``.

    Raises:
        InputError: something about it is wrong.
    """
    values = {"laws": list(laws), "goal": goal, **more}
    return study(
        "tune", scenario, changes, workers=workers, scheduler=scheduler, out=out,
        progress=progress, **values,
    )  # fmt: skip


def benchmark(
    scenarios: Sequence[ScenarioLike] = ("paper_arm",),
    *,
    laws: Sequence[Law] | None = None,
    predictors: Sequence[str] = BENCHMARK_PREDICTORS,
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
    **more: Any,
) -> Study:
    """Run laws and predictors alike: rising delays, patterns, networks and uncertain plants.

    Args:
        scenarios: each as for `simulate`.
        laws: names, classes or laws; all shipped ones of torques by default.
        predictors: ``none`` and names of predictors.
        workers: as for `sweep`.
        scheduler: as for `sweep`.
        out: as for `sweep`.
        progress: as for `sweep`.
        more: what else a benchmark may say: ``delays_ms``, ``networks``, ``windows``,
            ``duration_s``, ``gains``, ``plants``, ``seeds``.

    Raises:
        InputError: something about it is wrong.
    """
    names, makers = _named_laws(list(torque_laws()) if laws is None else laws)
    values = {
        "laws": names, "predictors": list(predictors), "delays_ms": list(BENCHMARK_DELAYS_MS),
        "networks": [], **more,
    }  # fmt: skip
    given = list(map(Scenario, scenarios))
    return _result_of(given, values, Benchmark, makers, (workers, scheduler, out, progress))


def study(
    kind: str,
    scenario: ScenarioLike = "paper_arm",
    changes: Changes | None = None,
    *,
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
    **definition: Any,
) -> Study:
    """Run a study of any kind of one scenario, also of a kind that an installed package adds.

    Args:
        kind: its name, the command of its command line.
        scenario: as for `simulate`.
        changes: as for `simulate`.
        workers: as for `sweep`.
        scheduler: as for `sweep`.
        out: as for `sweep`.
        progress: as for `sweep`.
        definition: what its file says.

    Raises:
        InputError: something about it is wrong.
    """
    with naming(Path("study")):
        made = study_type(kind)
    given, values = Scenario(scenario, changes), {"name": kind, **definition}
    return _result_of(given, values, made, {}, (workers, scheduler, out, progress))


def _named_laws(laws: Sequence[Law]) -> tuple[list[str], dict[str, Maker]]:
    """Return the names of laws, and what makes those that are given as more than a name."""
    named = [named_law(law) for law in laws]
    return [name for name, _ in named], {n: make for _, own in named for n, make in own.items()}


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


def _result_of(
    given: Scenario | list[Scenario], values: Mapping[str, Any],
    build: Callable[[dict[str, Any], Path], StudyOfRuns], makers: dict[str, Maker], how: _How,
) -> Study:  # fmt: skip
    """Run a study of a scenario, or of a list of scenarios, and judge it."""
    workers, scheduler, out, on_progress = how
    source = Path(getattr(build, "kind", "margin"))

    def study_of(files: list[str]) -> StudyOfRuns:
        named = {"scenarios": files} if isinstance(given, list) else {"scenario": files[0]}
        return build({**values, **named}, source)

    each = given if isinstance(given, list) else [given]
    with ExitStack() as stack:
        for scenario in each:
            stack.enter_context(scenario.laws())
        stack.enter_context(laws_given(makers))
        place = stack.enter_context(tempfile.TemporaryDirectory()) if out is None else out
        session = study_session(each, study_of, Path(place), workers, scheduler, on_progress)
        study, folder = stack.enter_context(session)
        return Study(write_study(study, folder), folder.rows)


@contextmanager
def study_session(
    given: Sequence[Scenario],
    build: Callable[[list[str]], StudyOfRuns],
    out: Path,
    workers: int | None = 0,
    scheduler: str | None = None,
    on_progress: OnProgress | None = None,
    *,
    overwrite: bool = False,
) -> Iterator[tuple[StudyOfRuns, StudyFolder]]:
    """Run a study of scenarios; yield it and its folder, which is locked meanwhile.

    Each scenario is written to a file, from which every run reads it; `build` gets these files.
    """
    place = out.resolve()
    if overwrite:
        new_folder(given[0].name, place, overwrite=True)
    study = build(written_scenarios(given, place))
    with session_of(study, place, workers, scheduler, on_progress) as folder:
        yield study, folder


def written_scenarios(given: Sequence[Scenario], folder: Path) -> list[str]:
    """Write scenarios below a folder, unless they are there; return their files.

    Raises:
        InputError: two have the same name.
    """
    (folder / "base").mkdir(parents=True, exist_ok=True)
    files = {str(folder / "base" / f"{each.name}.yaml"): each.to_yaml() for each in given}
    if len(files) < len(given):
        names = ", ".join(each.name for each in given)
        raise InputError(f"scenarios: must have different names: {names}")
    for name, text in files.items():
        file = Path(name)
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
    return list(files)


@contextmanager
def session_of(
    study: StudyOfRuns,
    out: Path,
    workers: int | None,
    scheduler: str | None,
    on_progress: OnProgress | None,
) -> Iterator[StudyFolder]:
    """Do the runs that a study's folder lacks; yield the folder, which is locked meanwhile."""
    done = itertools.count(1)

    def progress(_row: Row, at_most: int, _before: bool) -> None:
        if on_progress is not None:
            on_progress(next(done), at_most)

    def team() -> AbstractContextManager[Workers]:
        if workers == 0 and scheduler is None:
            return nullcontext(_Here())
        from deploy.study.execution.dask_workers import DaskWorkers  # heavy

        return DaskWorkers(workers or None, scheduler, study.laws)

    with open_session(
        study, team, out, nullcontext(progress), is_elsewhere=scheduler is not None
    ) as ended:
        if ended.lost is not None:
            raise ended.lost
        yield ended.folder
