"""Studies: which runs of which scenarios they request, and summaries of their rows.

Also the common definitions of sweeps and margins: name, overrides, seeds, scenarios.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from bus_schema.configuration import StrictModel
from controller.laws.read_files import files_read
from deploy.judge.conditions import Conditions, conditions_of_runs
from deploy.judge.findings.loss_reason import AFTER_S
from deploy.judge.run_rows import PROVENANCE, Row, early_row, failed_row, row
from deploy.judge.tested_with import tested_with
from deploy.run.confirmation import CONFIRMATION, confirmations, confirmed_row
from deploy.run.execute import InProcess, execute
from deploy.run.run_folder import RunFolder, provenance
from deploy.scenario.checking.warnings import all_warnings
from deploy.scenario.definition import Name
from deploy.scenario.scenario import SHIPPED as SHIPPED_SCENARIOS
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.xacro_arguments import split_arguments
from deploy.scenario.yaml_files import find_yaml, override, read_yaml
from deploy.study.execution.growth import Growth, may_rise
from deploy.study.execution.provenance import provenance_of
from deploy.study.statistics import commonest_error, seeds_of
from plant_emulator.plant_loop import PlantLoop

SHIPPED = Path(str(resources.files("deploy").joinpath("studies")))

OF_BOUND = "% of the bound"
ONE_START = "arms_with_one_start"
"""Key of the findings about arms on which all starts are the same."""
_MOST_SEEDS = 10_000

Value = TypeVar("Value")


def require_different(values: list[Any]) -> list[Any]:
    """Require a list of one or more different values, of any YAML type."""
    if not values or len({json.dumps(value, default=str) for value in values}) < len(values):
        raise ValueError("a list of different values")
    return values


Different = Annotated[list[Value], AfterValidator(require_different)]
"""Different values of a type."""


def _to_seeds(value: Any) -> Any:
    seeds = list(range(1, value + 1)) if type(value) is int and value <= _MOST_SEEDS else value
    whole = isinstance(seeds, list) and all(type(seed) is int and seed >= 0 for seed in seeds)
    if not whole or not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"a number of seeds from 1 to {_MOST_SEEDS}, or a list of different whole numbers"
        )
    return seeds


Seeds = Annotated[list[int], BeforeValidator(_to_seeds)]
"""Given as a list, or as a number n for 1 to n."""


class StudyDefinition(StrictModel):
    """Common keys of all studies' YAML files.

    Attributes:
        name: name of the study.
        fixed: (in YAML ``set``) scenario values that are the same in all runs, by dotted key.
        seeds: number of seeds, or a list.
        confirm: simulate every run on other physics too, see `deploy.run.confirmation`.
    """

    name: Name
    fixed: Annotated[dict[str, Any], Field(alias="set", default_factory=dict)]
    seeds: Seeds = Field(default=[1])
    confirm: bool | None = None

    @property
    def fixed_overrides(self) -> tuple[str, ...]:
        return tuple(override(key, value) for key, value in self.fixed.items())


def scenario_name(name_or_path: str, folder: Path) -> str:
    """Return a scenario's name in a study: shipped ones by name, files by their absolute path.

    Args:
        name_or_path: a path relative to `folder`, or any name that commands accept.
        folder: folder of the study's definition.

    Raises:
        ScenarioError: there is no such scenario.
    """
    file, arguments = split_arguments(name_or_path)
    found = find_yaml(file, SHIPPED_SCENARIOS, folder)
    words = [f"{name}:={value}" for name, value in arguments.items()]
    return found.stem if found.parent == SHIPPED_SCENARIOS else " ".join([str(found), *words])


def study_values(
    name_or_path: str,
    more: Mapping[str, Any] = MappingProxyType({}),
    fixed: Mapping[str, Any] = MappingProxyType({}),
    fits: Callable[[Path], bool] = lambda _file: True,
) -> tuple[dict[str, Any], Path]:
    """Return the definition in a study's file, and the file.

    Args:
        name_or_path: its path, or the name of a shipped one.
        more: values that take precedence over the file.
        fixed: scenario values that take precedence over those of its ``set``.
        fits: whether a shipped file is of the wanted kind.

    Raises:
        ScenarioError: it cannot be read.
    """
    path = find_yaml(name_or_path, SHIPPED, fits=fits)
    values = {**read_yaml(path), **more}
    own = values.get("set") or {}
    if fixed and isinstance(own, dict):  # or the schema refuses it
        values["set"] = {**own, **fixed}
    return values, path


def is_sweep(file: Path) -> bool:
    """Whether a study's file is for `sweep`; the others are for `margin`."""
    return "grid" in read_yaml(file)


@dataclass(frozen=True)
class PlannedRun:
    """One run of a study.

    Attributes:
        point: name of its values except the seed; names sort in the order of a study.
        scenario: a scenario file, or the name of a shipped one.
        overrides: its overrides, as ``dotted.key=value``, without the seed.
        seed: the scenario's seed.
        columns: varied values, by column of its table; with the seed, they identify a run.
        confirm: simulate it on other physics too.
        recording: the folder to record it to, below the study's; None keeps only its row.
        ends_early: it ends soon after its first tick outside, unless a program of its own controls.
    """

    point: str
    scenario: str
    overrides: tuple[str, ...]
    seed: int
    columns: dict[str, Any]
    confirm: bool = False
    recording: Path | str | None = None
    ends_early: bool = False

    @property
    def key(self) -> tuple[str, int]:
        """Identity of the run within its study."""
        return self.point, self.seed


def row_of(run: PlannedRun) -> Row:
    """Run and judge; any error becomes the row's `error`. The row holds its provenance."""
    try:
        with files_read() as read:
            setup = load_setup(run.scenario, [*run.overrides, f"seed={run.seed}"])
            values = _judged(setup, run)
        made_by = provenance_of(setup, run.confirm, _inputs(read, run))
    except Exception as error:  # noqa: BLE001 - one bad run must not end a study
        return failed(run, f"{type(error).__name__}: {error}")
    return {**values, **run.columns, "point": run.point, PROVENANCE: made_by}


def _judged(setup: Setup, run: PlannedRun) -> Row:
    plants, is_ours = list[PlantLoop](), setup.scenario.controller.process is None

    def begin(plant: PlantLoop) -> None:
        plant.end_after_loss(AFTER_S)
        plants.append(plant)

    with _folder(setup, run) as folder:
        done = execute(setup, InProcess(begin) if run.ends_early and is_ours else None, folder)
        values = row(done.result, run.seed)
        if any(plant.ended_early for plant in plants):
            values = early_row(values)
        if run.confirm:
            values = confirmed_row(setup, done)
            done.result = done.result.replaced(confirmation=confirmations([values]))
        if folder is not None:
            done.keep(folder)
    return values


def _inputs(read: Mapping[str, str], run: PlannedRun) -> dict[str, str]:
    """Return the files read except the scenario, of which a study keeps a digest, and results."""
    results = f"{run.recording}/"
    file = Path(run.scenario)
    own = {str(file.absolute()), str(file.resolve())}
    return {k: v for k, v in read.items() if k not in own and not k.startswith(results)}


def _folder(setup: Setup, run: PlannedRun) -> AbstractContextManager[RunFolder | None]:
    """Return the folder where a run is recorded, if it is."""
    if run.recording is None:
        return nullcontext()
    return RunFolder.begin(setup, Path(run.recording), overwrite=True)


def failed(run: PlannedRun, error: str) -> Row:
    """Return the row of a run that left nothing to judge."""
    return {**failed_row(run.seed, error), **run.columns, "point": run.point}


def rows_by(rows: Iterable[Value], key: Callable[[Value], str]) -> dict[str, list[Value]]:
    """Group rows by a common property, such as their point."""
    found: dict[str, list[Value]] = {}
    for each in rows:
        found.setdefault(key(each), []).append(each)
    return found


def column_type(values: Iterable[Any]) -> str:
    """Return the Parquet type for all values of a scenario's key."""
    types = {type(value) for value in values}
    if types == {bool}:
        return "bool"
    return "double" if types <= {int, float} else "string"


def digest_of(*contents: bytes) -> str:
    """Return a digest that shows whether a scenario or file has changed."""
    return hashlib.sha256(b"".join(contents)).hexdigest()[:16]


class StudyOfRuns(ABC):
    """Base of all kinds of studies.

    It may request more runs after each row, as a search does.

    Args:
        values: its definition, in the form of its YAML file.
        source: that file, or a name for messages; paths of scenarios start beside it.

    Attributes:
        kind: ``kind`` of its summary, such as ``sweep`` or ``margin``.
        growth: how keys of its definition may change in the same folder, where lists may not just
            get further entries.
        definition: its definition, with scenarios named by `scenario_name`.
        columns: names and Parquet types of varied values.
        bases: the scenarios that it varies.
        files: digests, by path, of files of its runs in addition to those of `bases`.

    Raises:
        ScenarioError: the definition cannot be used, or names a scenario that cannot be run.
    """

    kind: ClassVar[str]
    growth: ClassVar[Mapping[str, Growth]] = MappingProxyType({"plants": may_rise})
    definition: StudyDefinition
    columns: Mapping[str, str]
    bases: list[Setup]
    files: Mapping[str, str] = MappingProxyType({})

    @abstractmethod
    def __init__(self, values: Mapping[str, Any], source: Path) -> None: ...

    @property
    def variants(self) -> list[Setup]:
        """Scenarios in every setting, of which `bases` has one each."""
        return self.bases

    @property
    def laws(self) -> list[str]:
        """Names of the laws of its runs."""
        return list(dict.fromkeys(setup.scenario.controller.name for setup in self.variants))

    @property
    def unit(self) -> str:
        """Of what a gate looks at: the smallest margin to a bound, unless a kind has others."""
        return OF_BOUND

    @property
    def tested_with(self) -> dict[str, dict[str, Any]]:
        """The test of its results, as `deploy.judge.tested_with` describes it."""
        files = {f"file {Path(name).name}": {"digest": each} for name, each in self.files.items()}
        return {**tested_with(self.bases, self.own_test), **files}

    @property
    def own_test(self) -> dict[str, Any]:
        """Values of its definition that belong to the test."""
        return {"seeds": self.definition.seeds}

    @property
    def expected(self) -> int:
        """Number of runs, as far as known now."""
        return self._requested

    @cached_property
    def _requested(self) -> int:
        return sum(1 for _ in self.first())

    @abstractmethod
    def first(self) -> Iterable[PlannedRun]:
        """Return the runs requested at the beginning."""

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:  # noqa: ARG002 (of searches)
        """Return the runs requested after a run's row."""
        return ()

    def ahead(self) -> Iterable[PlannedRun]:
        """Return runs that may be requested later, for idle workers."""
        return ()

    def keeps(self, row: Row) -> bool:  # noqa: ARG002 (few do)
        """Whether its folder keeps an earlier row that a complete study has not requested."""
        return False

    @abstractmethod
    def findings(self, rows: list[Row]) -> dict[str, Any]:
        """Return the results, and whether the study is `completed`, ready for JSON."""

    def summary(self, rows: list[Row]) -> dict[str, Any]:
        """Return the results, for ``summary.json``.

        Args:
            rows: all rows so far.
        """
        return {
            "kind": self.kind,
            "name": self.definition.name,
            "runs": len(rows),
            "runs_failed": sum(row["error"] is not None for row in rows),
            "commonest_error": commonest_error(rows),
            "seeds": seeds_of(rows) or self.definition.seeds,
            CONFIRMATION: confirmations(rows),
            **self.findings(rows),
        }

    def recall(self, summary: Mapping[str, Any]) -> None:  # noqa: B027 (few have any)
        """Take over what today's commands cannot find again from the summary of all its rows."""

    def keep_files(self, summary: dict[str, Any], folder: Path) -> None:  # noqa: B027 (few have any)
        """Add files to the folder of the study, and their paths to its summary."""

    def provenance(self) -> dict[str, Any]:
        """Return what was run, with what, and where, for ``manifest.json``."""
        return {**provenance(), "warnings": all_warnings(self.bases)}

    def conditions(self, summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Conditions:
        """Return the conditions of its tables, figures and rows.

        Args:
            summary: the summary of its rows.
            manifest: ``manifest.json`` of its folder.
        """
        durations = {base.scenario.name: f"{base.scenario.duration_s:g} s" for base in self.bases}
        return {
            "study": " ".join(dict.fromkeys([summary["kind"], summary["name"]])),
            "quantity": _quantity(summary),
            **conditions_of_runs(self.bases, manifest),
            "scenario": ", ".join(durations),
            "law": ", ".join(self.laws),
            "duration": ", ".join(f"{name} {duration}" for name, duration in durations.items()),
            "starts": starts_text(summary),
            "seeds": ", ".join(map(str, summary["seeds"])),
            "set": ", ".join(self.definition.fixed_overrides) or "nothing",
        }


def _quantity(summary: Mapping[str, Any]) -> str:
    """Describe the varied quantity, with its unit and resolution."""
    if "axes" in summary:
        return "; ".join(
            f"{', '.join(axis['keys'])} = {', '.join(map(shown_value, axis['values']))}"
            for axis in summary["axes"]
        )
    text = f"{summary['title']} ({summary['unit'] or 'no unit'})"
    if "values" in summary:
        return f"{text} at {', '.join(f'{value:g}' for value in summary['values'])}"
    return f"{text} up to {summary['limit']:g}, found to within {summary['resolution']:g}"


def shown_value(value: Any) -> str:
    """Return a swept value as text; whole numbers without a decimal point."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def starts_text(summary: Mapping[str, Any]) -> str:
    """Describe the starts and plants of a study, and which starts are all the same."""
    offsets = summary.get("offsets", [1.0])
    text = "initial offset × " + ", ".join(f"{offset:g}" for offset in offsets)
    if arms := summary.get(ONE_START):
        text += f"; once on {', '.join(arms)}, where the initial offset is 0"
    if summary.get("plants") is None:
        return text
    return f"{text}; {summary['plants']} plants of plant_seed {summary['plant_seed']}"
