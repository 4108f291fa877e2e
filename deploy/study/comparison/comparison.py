"""A comparison: the same scenario, plant and seed under several laws, in virtual time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from bus_schema.messages import topics
from bus_schema.recording.atomic_files import write_json
from controller.laws import LAWS
from controller.laws.custom import custom_laws_left_out
from deploy.judge.conditions import Conditions, conditions_of_runs
from deploy.judge.run_rows import row, write_rows
from deploy.run import run_folder
from deploy.run.confirmation import CONFIRMATION, confirmation_of
from deploy.run.execute import How, JudgedRun, execute, lockstep_setup
from deploy.run.new_folder import new_folder, resolved_out
from deploy.run.simulate import require_simulable
from deploy.scenario import study_keys
from deploy.scenario.effective import portable_scenario, values_in_common
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, naming, parse_override
from deploy.study.comparison.settling import SettlingTest

KIND = "comparison"
_SHOWN_KEYS = 8
SETTLING = TypeAdapter(list[SettlingTest])
"""From and to what ``summary.json`` has of settling tests."""


def load_setups(scenario: str, overrides: Sequence[str], laws: Sequence[str] | None) -> list[Setup]:
    """The scenario under each law, all checked before any of them runs.

    Args:
        scenario: the scenario.
        overrides: what is set in it.
        laws: which; all shipped ones and the scenario's own if None.

    Raises:
        ScenarioError: anything about it is wrong, such as a law that does not exist.
    """
    with naming(Path("compare")):
        given = dict(map(parse_override, overrides))
        study_keys.require_effect(
            given, {study_keys.LAW: "as --laws", study_keys.UNCERTAINTY: "to sweep or margin"}
        )
    if laws is None:
        laws = study_keys.laws_beside(load_setup(scenario, overrides).scenario.controller.law)
    setups = [load_setup(scenario, [*overrides, f"controller.law={law}"]) for law in laws]
    with naming(Path("compare")):
        study_keys.require_link_effect(given, setups)
    for setup in setups:
        if setup.scenario.controller.process is None:
            require_simulable(setup)
    return setups


@dataclass(frozen=True)
class ComparedRuns:
    """Runs of one scenario under several laws, in the order asked for.

    Attributes:
        runs: a run for each law.
        settling: what became of starts from near and far, for each law that was put to that test.
    """

    runs: list[JudgedRun]
    settling: list[SettlingTest] = field(default_factory=list)

    @property
    def drawn(self) -> list[JudgedRun]:
        """Runs with something to draw."""
        return [run for run in self.runs if len(run.data.tables[topics.PLANT_TRUTH.name]) > 1]

    def colour_index(self, law: str) -> int:
        """Place of a law among all, which gives its colour."""
        return [run.law for run in self.runs].index(law)


class ComparisonFolder(run_folder.ResultFolder):
    """The files of a comparison, with a folder for each law's run inside.

    A comparison of the same scenario may be made in the folder of an earlier one: it grows by laws,
    and runs of shipped laws that came to their end are not made again.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.rows = path / "comparison.parquet"
        self._grows = False

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
        laws = [setup.scenario.controller.name for setup in setups]
        manifest = {**run_folder.manifest_of(setups), "laws": laws}
        before = {} if out is None or overwrite else run_folder.read_manifest(out)
        if out is not None and isinstance(before.get("laws"), list):
            folder = ComparisonFolder(resolved_out(out))
            folder._require_same_scenario(setups, list(map(str, before["laws"])))
            manifest, folder._grows = run_folder.grown_from(before, manifest), True
        else:
            name = f"compare-{setups[0].scenario.name}"
            folder = ComparisonFolder(new_folder(name, out, overwrite=overwrite))
        folder.lock()
        write_json(folder.manifest, manifest)
        return folder

    def known(self, setup: Setup) -> JudgedRun | None:
        """The whole run that is there already of a shipped law; others may have changed since."""
        law = setup.scenario.controller.name
        folder = run_folder.RunFolder(self._law_path(law))
        is_whole = run_folder.read_summary(folder.path).get("completed")
        if not (self._grows and law in LAWS and is_whole):  # overwritten, it has folders of before
            return None
        try:
            same = folder.scenario.read_text(encoding="utf-8") == portable_scenario(setup)
            return judged_again(law, folder.path) if same else None
        except (OSError, run_folder.RunFolderError):
            return None

    def earlier_settling(self) -> dict[str, SettlingTest]:
        """Settling tests that are there already, by law."""
        told = SETTLING.validate_python(run_folder.read_summary(self.path).get("settling", []))
        return {test.law: test for test in told}

    def _require_same_scenario(self, setups: Sequence[Setup], laws: Sequence[str]) -> None:
        """Check that what the folder compares is the same but for laws, all of which are asked for.

        Raises:
            ScenarioError: it is not; keys that differ are named.
        """
        asked = {setup.scenario.controller.name: setup for setup in setups}
        for law in [law for law in laws if self._law_path(law).is_dir()]:
            if law not in asked:
                raise ScenarioError(
                    f"--out {self.path}: holds a comparison with {law}: must be among --laws, or"
                    " give --overwrite"
                )
            with custom_laws_left_out():
                there = load_setup(str(run_folder.RunFolder(self._law_path(law)).scenario))
            found, wanted = (values_in_common(each) for each in (there, asked[law]))
            keys = sorted(key for key in found | wanted if found.get(key) != wanted.get(key))
            if set(keys) - {"clock"}:  # of a process, which runs in lockstep
                raise ScenarioError(
                    f"--out {self.path}: holds a comparison of another scenario ({law}):"
                    f" {', '.join(keys[:_SHOWN_KEYS])}: must be the same, or give --overwrite"
                )

    def add(self, setup: Setup, how: How | None = None) -> JudgedRun:
        """Run one law in its folder, and judge it; `how` as `execute`."""
        if setup.scenario.controller.process is not None:
            setup = lockstep_setup(setup)
        path = self._law_path(setup.scenario.controller.name)
        folder = run_folder.RunFolder.begin(setup, path, overwrite=True)
        run = execute(setup, how, folder)
        run.keep(folder)
        return run

    def confirm(self, run: JudgedRun) -> None:
        """Simulate a run on other physics too, unless it was, and keep what they say of it."""
        if CONFIRMATION not in run.summary:
            run.summary[CONFIRMATION] = confirmation_of(run.data)
            write_json(self._law_path(run.law) / "summary.json", run.summary)

    def conclude(self, comparison: ComparedRuns) -> Conditions:
        """Write rows and summary of all runs; under what conditions they came about."""
        setups = [run.data.setup for run in comparison.runs]
        conditions = conditions_of_runs(setups, run_folder.read_manifest(self.path))
        rows = [row(run.summary, run.seed) for run in comparison.runs]
        write_rows(rows, self.rows, conditions=conditions)
        write_json(self.summary, {**_summary(comparison), "conditions": conditions})
        return conditions

    def load(self) -> ComparedRuns:
        """The comparison, read back from the recordings of its runs, which are judged again.

        Raises:
            RunFolderError: a run is missing or cannot be read.
        """
        summary = run_folder.read_summary(self.path)
        laws = summary.get("laws")
        if not isinstance(laws, dict) or not laws:
            raise run_folder.RunFolderError(f"{self.summary}: names no laws")
        paths = {law: self._law_path(law) for law in laws}
        return ComparedRuns(
            [judged_again(law, path) for law, path in paths.items()],
            SETTLING.validate_python(summary.get("settling", [])),
        )

    def _law_path(self, law: str) -> Path:
        return self.path / re.sub(r"[^A-Za-z0-9_.-]", "_", law)


def judged_again(name: str, path: Path) -> JudgedRun:
    """A recorded run; what its recording cannot know is what its folder tells.

    Raises:
        RunFolderError: it cannot be read.
    """
    data, _ = run_folder.load_run(path)
    run, before = JudgedRun(name, data, path=path), run_folder.read_summary(path)
    run.summary.update({CONFIRMATION: before[CONFIRMATION]} if CONFIRMATION in before else {})
    return run


def _summary(comparison: ComparedRuns) -> dict[str, Any]:
    """What a comparison says: its common ground, and every law's own summary."""
    common = comparison.runs[0]
    return {
        "kind": KIND,
        "scenario": common.summary["scenario"],
        "seed": common.seed,
        "clock": common.summary["clock"],
        "laws": {run.law: run.summary for run in comparison.runs},
        "settling": SETTLING.dump_python(comparison.settling),
    }
