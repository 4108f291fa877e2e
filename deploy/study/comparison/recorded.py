"""Recorded runs side by side: any runs that drive the same joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages import topics
from controller.laws.custom import is_custom
from deploy.judge.arithmetic import difference_of_arithmetic
from deploy.judge.recorded_ticks import tick_numbers
from deploy.judge.run_data import RunData, stamps_s
from deploy.run.execute import JudgedRun
from deploy.run.run_folder import RunFolderError, load_run, read_manifest, read_summary
from deploy.run.simulate import CLOCK as SIMULATED
from deploy.scenario.effective import values_in_common
from deploy.scenario.referenced_files import DATA_FILES
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.execution.identity import STUDY_FILE

Rows = NDArray[np.intp]
_OF_STUDIES = "to compare studies, repeat one with --baseline and the folder of the other"

KIND = "diff"
_COMPARED = ("position", "velocity", "torque")
_GAINS = "controller.gains."
_FILES = ("robot.urdf", "reference.file", "distribution_file")


class Parting(NamedTuple):
    """Tick at which a run departs from the first one.

    Attributes:
        tick: tick of the first run at which, among the instants common to both, position, velocity
            or torque of a joint first differ in a bit; or the one at which either run ends.
        time_s: time of that tick.
        largest_rad: largest difference of a joint's positions over these instants; None without
            any.
        is_end: nothing differs before that tick, where one of them ends.
    """

    tick: int
    time_s: float
    largest_rad: float | None
    is_end: bool


@dataclass(frozen=True, kw_only=True)
class RecordedRuns(ComparedRuns):
    """Runs side by side, by labels instead of laws; each is compared with the first.

    Attributes:
        paths: folders or MCAP files of the runs.
        partings: parting of each run from the first; None if all common ticks are equal to the bit.
        differing: values of the scenarios by run, as JSON, for each key that differs; None where a
            scenario lacks it. Without values of a host, gains of laws that none of the runs uses,
            and the clock if one is a simulation.
    """

    paths: Sequence[Path]
    partings: Sequence[Parting | None]
    differing: dict[str, list[str | None]]

    @property
    def labels(self) -> list[str]:
        return [run.law for run in self.runs]

    @property
    def manifests(self) -> list[dict[str, object]]:
        """``manifest.json`` of each run; empty if there is none."""
        return [read_manifest(path if path.is_dir() else path.parent) for path in self.paths]

    @property
    def differences_of_arithmetic(self) -> dict[str, str]:
        """Explain why the last bits of a run may differ from the first one's, by its label."""
        first, *manifests = self.manifests
        return {
            run.law: sentence
            for run, manifest in zip(self.runs[1:], manifests, strict=True)
            if run.result.digest != self.runs[0].result.digest
            and (sentence := difference_of_arithmetic(first, manifest))
        }


def recorded_runs(paths: Sequence[Path]) -> RecordedRuns:
    """Read runs to be compared; the recordings are untrusted, and their laws are not imported.

    Args:
        paths: two or more folders or MCAP files of runs.

    Raises:
        ScenarioError: there are too few, or they cannot be compared.
        RunFolderError: one cannot be read.
    """
    places = [path.resolve() for path in paths]
    if len(places) < 2:
        raise ScenarioError("diff: needs two recorded runs or more")
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise ScenarioError(f"{path}: is given twice; must be different runs")
    read = [_read(label, path) for label, path in zip(_labels(places), paths, strict=True)]
    runs = [run for run, _ in read]
    _require_same_joints(paths, runs)
    partings = [_parting(runs[0], run) for run in runs]
    differing = {
        key: values
        for key, values in _differing([each for _, each in read]).items()
        if _is_in_force(key, [run.data for run in runs])
    }
    return RecordedRuns(runs=runs, paths=places, partings=partings, differing=differing)


def read_again(path: Path) -> RecordedRuns:
    """Return the runs compared in a folder of `KIND`; raises as `recorded_runs`."""
    entries = read_summary(path).get("paths")
    if not isinstance(entries, list) or not all(isinstance(each, str) for each in entries):
        raise RunFolderError(f"{path}: names no runs")
    return recorded_runs([Path(each) for each in entries])


def _read(label: str, path: Path) -> tuple[JudgedRun, dict[str, str]]:
    """Return a recorded run, judged again, and its scenario's values; files as in the recording.

    The original files may be gone or changed by now. Copies may have other line ends.
    """
    try:
        data, contents = load_run(path)
    except RunFolderError as error:
        if (path / STUDY_FILE).is_file():
            raise RunFolderError(f"{error}; {_OF_STUDIES}") from error
        raise
    texts = {
        key: "\n".join(contents.attachments[name].decode(errors="replace").splitlines())
        for key, name in DATA_FILES.items()
        if name in contents.attachments
    }
    run = JudgedRun(label, data, path=path)
    return run, values_in_common(data.setup, texts)


def _labels(places: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that distinguish them."""
    parts = [(place if place.is_dir() else place.with_suffix("")).parts for place in places]
    parts = [each[:-1] if each[-1] == "run" else each for each in parts]
    for length in range(1, max(map(len, parts)) + 1):
        labels = ["/".join(each[-length:]) for each in parts]
        if len(set(labels)) == len(labels):
            return labels
    return [str(place) for place in places]


def _require_same_joints(paths: Sequence[Path], runs: Sequence[JudgedRun]) -> None:
    wanted = runs[0].data.setup.robot.joint_names
    for path, run in zip(paths, runs, strict=True):
        names = run.data.setup.robot.joint_names
        if names != wanted:
            raise ScenarioError(
                f"{path}: drives {', '.join(names)}: must be the joints of {paths[0]},"
                f" {', '.join(wanted)}"
            )


def _parting(first: JudgedRun, other: JudgedRun) -> Parting | None:
    ours, theirs = (run.data.tables[topics.PLANT_TRUTH.name] for run in (first, other))
    here, there = ticks_in_common(first.data, other.data)
    differs = np.zeros(len(here), dtype=bool)
    for field in _COMPARED:
        pair = ours[field][here], theirs[field][there]
        differs |= ~np.equal(*pair).reshape(len(here), -1).all(axis=1)
    grids = [run.data.setup.grid.period_ns for run in (first, other)]
    has_same_ticks = grids[0] == grids[1] and first.result.ticks == other.result.ticks
    if len(here) and has_same_ticks and not differs.any():
        return None
    numbers = tick_numbers(first.data)[here]
    after = int(numbers[-1]) + 1 if len(here) else 0  # one of them ends, or has more ticks
    tick = int(numbers[np.argmax(differs)]) if differs.any() else after
    apart = np.abs(ours["position"][here] - theirs["position"][there])
    largest = float(apart.max()) if len(here) else None
    return Parting(tick, tick * grids[0] * 1e-9, largest, is_end=not differs.any())


def ticks_in_common(first: RunData, other: RunData) -> tuple[Rows, Rows]:
    """Return the rows of the true motion of two runs at common instants, for any rates."""
    ours_ns, theirs_ns = (
        np.rint(1e9 * stamps_s(run.tables[topics.PLANT_TRUTH.name])).astype(np.int64)
        for run in (first, other)
    )
    _, here, there = np.intersect1d(ours_ns, theirs_ns, return_indices=True)
    return here, there


def _is_in_force(key: str, runs: Sequence[RunData]) -> bool:
    """Whether a value is relevant: gains of laws that ran, and no clock of a simulation."""
    if key == "clock":
        return all(run.clock != SIMULATED for run in runs)
    laws = {run.setup.scenario.controller.law for run in runs}
    sections = {"custom" if is_custom(law) else law for law in laws}
    return not key.startswith(_GAINS) or key.removeprefix(_GAINS).partition(".")[0] in sections


def _differing(values: Sequence[dict[str, str]]) -> dict[str, list[str | None]]:
    keys = dict.fromkeys(key for each in values for key in each)
    by_key = {key: [each.get(key) for each in values] for key in keys}
    return {key: _shown(key, each) for key, each in by_key.items() if len(set(each)) > 1}


def _shown(key: str, values: list[str | None]) -> list[str | None]:
    """Return values in a form to show: files are numbered by content."""
    if not key.endswith(_FILES):
        return values
    known = list(dict.fromkeys(each for each in values if each is not None))
    return [None if each is None else f"file {known.index(each) + 1}" for each in values]
