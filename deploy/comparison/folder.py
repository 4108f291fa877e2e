"""What a comparison leaves: a run of each law, all their numbers as rows and as a summary."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from bus_schema.recording.atomic_files import write_json
from controller.laws import LAWS
from controller.laws.custom import custom_laws_left_out
from deploy.comparison.comparison import Comparison, LawRun
from deploy.comparison.settling import SettlingTest
from deploy.runs.conditions import Conditions, conditions_of_runs
from deploy.runs.confirmation import CONFIRMATION, confirmation_of
from deploy.runs.fault_record import fault_record
from deploy.runs.judging.metrics import summarise
from deploy.runs.new_folder import new_folder, resolved_out
from deploy.runs.process_run import lockstep_setup, run_process
from deploy.runs.run_folder import (
    ResultFolder,
    RunFolder,
    RunFolderError,
    grown_from,
    load_run,
    manifest_of,
    read_manifest,
    read_summary,
)
from deploy.runs.run_rows import row, write_rows
from deploy.runs.simulate import Simulation
from deploy.scenario.agreement import values_in_common
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.written import portable_scenario
from deploy.scenario.yaml_files import ScenarioError

KIND = "comparison"
_SHOWN_KEYS = 8
SETTLING = TypeAdapter(list[SettlingTest])
"""From and to what ``summary.json`` has of settling tests."""


class ComparisonFolder(ResultFolder):
    """The files of a comparison, with a folder for each law's run inside.

    A comparison of the same scenario may be made in the folder of an earlier one: it grows by laws,
    and runs of shipped laws that came to their end are not made again.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.rows = path / "comparison.parquet"

    @staticmethod
    def begin(
        setups: Sequence[Setup], out: Path | None, *, overwrite: bool = False
    ) -> ComparisonFolder:
        """The folder of a new comparison, or of one that grows, locked, with a manifest.

        Args:
            setups: the scenario under each law.
            out: the folder asked for; ``runs/compare-<name>-<time>`` by default.
            overwrite: remove results that are there.

        Raises:
            ScenarioError: as `new_folder`, or the folder has a comparison of something else.
        """
        name, before = f"compare-{setups[0].scenario.name}", {}
        if out is not None and not overwrite and read_summary(out).get("kind") == KIND:
            folder = ComparisonFolder(resolved_out(out))
            folder._require_same_scenario(setups)
            before = read_manifest(folder.path)
        else:
            folder = ComparisonFolder(new_folder(name, out, overwrite=overwrite))
        folder.lock()
        laws = [setup.scenario.controller.name for setup in setups]
        now = {**manifest_of(setups), "laws": laws}
        write_json(folder.manifest, grown_from(before, now) if before else now)
        return folder

    def known(self, setup: Setup) -> LawRun | None:
        """The whole run that is there already of a shipped law; others may have changed since."""
        law = setup.scenario.controller.name
        folder = RunFolder(self._law_path(law))
        if law not in LAWS or not read_summary(folder.path).get("completed"):
            return None
        try:
            same = folder.scenario.read_text(encoding="utf-8") == portable_scenario(setup)
            return judged_again(law, folder.path) if same else None
        except (OSError, RunFolderError):
            return None

    def earlier_settling(self) -> dict[str, SettlingTest]:
        """Settling tests that are there already, by law."""
        told = SETTLING.validate_python(read_summary(self.path).get("settling", []))
        return {test.law: test for test in told}

    def _require_same_scenario(self, setups: Sequence[Setup]) -> None:
        """Check that what the folder compares is the same but for laws, all of which are asked for.

        Raises:
            ScenarioError: it is not; keys that differ are named.
        """
        laws = read_summary(self.path).get("laws")
        asked = {setup.scenario.controller.name: setup for setup in setups}
        for law in laws if isinstance(laws, dict) else {}:
            if law not in asked:
                raise ScenarioError(
                    f"--out {self.path}: holds a comparison with {law}: must be among --laws, or"
                    " give --overwrite"
                )
            with custom_laws_left_out():
                there = load_setup(str(RunFolder(self._law_path(law)).scenario))
            found, wanted = (values_in_common(each) for each in (there, asked[law]))
            keys = sorted(key for key in found | wanted if found.get(key) != wanted.get(key))
            if set(keys) - {"clock"}:  # of a process, which runs in lockstep
                raise ScenarioError(
                    f"--out {self.path}: holds a comparison of another scenario ({law}):"
                    f" {', '.join(keys[:_SHOWN_KEYS])}: must be the same, or give --overwrite"
                )

    def add(self, simulation: Simulation) -> LawRun:
        """Write the run of one law to its folder, and judge it."""
        setup = simulation.setup
        law = setup.scenario.controller.name
        folder = RunFolder.begin(setup, self._law_path(law), overwrite=True)
        data = simulation.data(simulation.write_log(folder.log))
        run = LawRun(law, data, summarise(data), folder.path)
        write_json(folder.summary, run.summary)
        if (record := fault_record(data)) is not None:
            write_json(folder.fault, record)
        return run

    def confirm(self, run: LawRun) -> None:
        """Simulate a run on other physics too, unless it was, and keep what they say of it."""
        if CONFIRMATION not in run.summary:
            run.summary[CONFIRMATION] = confirmation_of(run.data)
            write_json(self._law_path(run.law) / "summary.json", run.summary)

    def add_process(self, setup: Setup, on_start: Callable[[Callable[[], None]], None]) -> LawRun:
        """Run the scenario's process in its folder, and judge it; `on_start` as `run_process`."""
        name = setup.scenario.controller.name
        folder = RunFolder.begin(lockstep_setup(setup), self._law_path(name), overwrite=True)
        data, summary = run_process(setup, folder.path, on_start)
        write_json(folder.summary, summary)
        return LawRun(name, data, summary, folder.path)

    def conclude(self, comparison: Comparison) -> None:
        """Write rows and summary of all runs, with their conditions."""
        conditions = self.conditions(comparison)
        rows = [row(run.summary, run.seed) for run in comparison.runs]
        write_rows(rows, self.rows, conditions=conditions)
        write_json(self.summary, {**_summary(comparison), "conditions": conditions})

    def conditions(self, comparison: Comparison) -> Conditions:
        """Under what conditions the runs came about; none where there is no run."""
        setups = [run.data.setup for run in comparison.runs]
        return conditions_of_runs(setups, read_manifest(self.path)) if setups else {}

    def load(self) -> Comparison:
        """The comparison, read back from the recordings of its runs, which are judged again.

        Raises:
            RunFolderError: a run is missing or cannot be read.
        """
        summary = read_summary(self.path)
        laws = summary.get("laws")
        if not isinstance(laws, dict) or not laws:
            raise RunFolderError(f"{self.summary}: names no laws")
        paths = {law: self._law_path(law) for law in laws}
        return Comparison(
            [judged_again(law, path) for law, path in paths.items()],
            SETTLING.validate_python(summary.get("settling", [])),
        )

    def _law_path(self, law: str) -> Path:
        return self.path / re.sub(r"[^A-Za-z0-9_.-]", "_", law)


def judged_again(name: str, path: Path) -> LawRun:
    """A recorded run; what its recording cannot know is what its folder tells.

    Raises:
        RunFolderError: it cannot be read.
    """
    data, _ = load_run(path)
    summary, before = summarise(data), read_summary(path)
    kept = {CONFIRMATION: before[CONFIRMATION]} if CONFIRMATION in before else {}
    return LawRun(name, data, summary | kept, path)


def _summary(comparison: Comparison) -> dict[str, Any]:
    """What a comparison says: its common ground, and every law's own summary."""
    common = comparison.runs[0] if comparison.runs else None
    return {
        "kind": KIND,
        "scenario": common.summary["scenario"] if common else None,
        "seed": common.seed if common else None,
        "clock": common.summary["clock"] if common else None,
        "laws": {run.law: run.summary for run in comparison.runs},
        "settling": SETTLING.dump_python(comparison.settling),
    }
