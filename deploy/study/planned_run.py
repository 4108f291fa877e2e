"""One run of a study, and its row."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controller.laws.read_files import files_read
from deploy.judge.findings.loss import AFTER_S
from deploy.judge.run_rows import PROVENANCE, Row, early_row, failed_row, row
from deploy.run.confirmation import confirmations, confirmed_row
from deploy.run.execute import InProcess, execute
from deploy.run.run_folder import RunFolder
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.study.execution.provenance import provenance_of
from plant_emulator.plant_loop import PlantLoop


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
