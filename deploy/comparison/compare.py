"""A comparison: the same scenario, plant and seed under several laws, in virtual time."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import write_whole
from controller.laws import LAWS
from deploy.comparison.comparison import Comparison, LawRun
from deploy.comparison.settling import SettlingTest
from deploy.reports.compare_report import write_comparison_report
from deploy.runs.metrics import summarise
from deploy.runs.run_folder import RunFolder, RunFolderError, load_run
from deploy.runs.run_rows import row, write_rows
from deploy.runs.simulate import Simulation
from deploy.scenario.scenario import Setup, load_setup
from deploy.scenario.yaml_files import ScenarioError

KIND = "comparison"


def parse_laws(text: str | None) -> list[str]:
    """Names of laws from ``a,b,…``; all registered ones by default.

    Raises:
        ScenarioError: there is no name in it.
    """
    if text is None:
        return list(LAWS)
    laws = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not laws:
        raise ScenarioError(f"--laws {text!r}: must name one or more of {', '.join(LAWS)}")
    return laws


def load_setups(scenario: str, overrides: Sequence[str], laws: Sequence[str]) -> list[Setup]:
    """The scenario under each law, all checked before any of them runs.

    Raises:
        ScenarioError: anything about it is wrong, such as a law that does not exist.
    """
    return [load_setup(scenario, [*overrides, f"controller.law={law}"]) for law in laws]


@dataclass
class ComparisonFolder:
    """The files of a comparison, with a folder for each law's run inside.

    Attributes:
        path: the folder.
    """

    path: Path
    _runs: list[LawRun] = field(default_factory=list)
    _settling: list[SettlingTest] = field(default_factory=list)

    @staticmethod
    def create(name: str, out: Path | None) -> ComparisonFolder:
        """The folder for a new comparison, by default ``runs/<name>-<time>``.

        Raises:
            ScenarioError: it cannot be created or written to.
        """
        folder = ComparisonFolder(RunFolder.create(name, out).path)
        folder.rows.unlink(missing_ok=True)
        return folder

    @property
    def rows(self) -> Path:
        return self.path / "comparison.parquet"

    @property
    def summary(self) -> Path:
        return self.path / "summary.json"

    @property
    def manifest(self) -> Path:
        return self.path / "manifest.json"

    @property
    def report(self) -> Path:
        return self.path / "report.html"

    def add(self, simulation: Simulation) -> LawRun:
        """Write the run of one law to its folder, and judge it."""
        setup = simulation.setup
        law = setup.scenario.controller.law
        folder = RunFolder.create(law, self.path / _folder_name(law))
        folder.write_scenario(setup)
        folder.write_manifest(setup, {})
        simulation.write_log(folder.log)
        data = simulation.data()
        run = LawRun(law, data, summarise(data))
        folder.write_summary(run.summary)
        self._runs.append(run)
        return run

    def add_settling(self, test: SettlingTest) -> None:
        """Take in how a law settled from near and far."""
        self._settling.append(test)

    def conclude(self) -> Comparison:
        """Write rows, summary, manifest and report of all runs so far."""
        comparison = Comparison(list(self._runs), list(self._settling))
        write_rows([row(run.summary, run.seed) for run in comparison.runs], self.rows)
        write_whole(self.summary, json.dumps(_summary(comparison), indent=2) + "\n")
        self._write_manifest(comparison)
        write_comparison_report(comparison, self.report)
        return comparison

    def _write_manifest(self, comparison: Comparison) -> None:
        """What all runs have in common, with the gains of every law; written once."""
        if self.manifest.exists() or not comparison.runs:
            return
        manifests = {
            run.law: json.loads((self.path / _folder_name(run.law) / "manifest.json").read_text())
            for run in comparison.runs
        }
        first = next(iter(manifests.values()))
        first["gains"] = {
            law: gains for one in manifests.values() for law, gains in one["gains"].items()
        }
        first["laws"] = list(manifests)
        write_whole(self.manifest, json.dumps(first, indent=2) + "\n")


def is_comparison(path: Path) -> bool:
    """Whether a folder holds a comparison."""
    try:
        summary = json.loads((path / "summary.json").read_text())
    except (OSError, ValueError):
        return False
    return isinstance(summary, dict) and summary.get("kind") == KIND


def load_comparison(path: Path) -> ComparisonFolder:
    """Read a comparison back from the recordings of its runs, and judge them again.

    Raises:
        RunFolderError: a run is missing or cannot be read.
    """
    summary = json.loads((path / "summary.json").read_text())
    folder = ComparisonFolder(path)
    for law in _laws_in(summary, path):
        data, _ = load_run(path / _folder_name(law))
        folder._runs.append(LawRun(law, data, summarise(data)))
    for values in summary.get("settling", []):
        folder.add_settling(SettlingTest.from_values(values))
    return folder


def _laws_in(summary: dict[str, Any], path: Path) -> Iterator[str]:
    laws = summary.get("laws")
    if not isinstance(laws, dict) or not laws:
        raise RunFolderError(f"{path / 'summary.json'}: names no laws")
    yield from laws


def _summary(comparison: Comparison) -> dict[str, Any]:
    """What a comparison says: its common ground, and every law's own summary."""
    common = comparison.runs[0] if comparison.runs else None
    return {
        "kind": KIND,
        "scenario": common.summary["scenario"] if common else None,
        "seed": common.seed if common else None,
        "clock": common.summary["clock"] if common else None,
        "laws": {run.law: run.summary for run in comparison.runs},
        "settling": [test.values() for test in comparison.settling],
    }


def _folder_name(law: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", law)
