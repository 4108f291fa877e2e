"""Runs of one scenario under several laws, in the folder of a comparison."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bus_schema.messages import topics
from deploy.judge.metrics import judge
from deploy.judge.run_rows import Row, row
from deploy.run import run_folder
from deploy.run.confirmation import CONFIRMATION
from deploy.run.execute import JudgedRun
from deploy.study.comparison.settling import SETTLING, SettlingTest

KIND = "comparison"
VARIED = {"law": "string", "offset_rad": "double"}
COLUMNS = {"point": "string", **VARIED}
"""Names and Parquet types of its rows' first columns; the scenario's own start has no offset."""


@dataclass(frozen=True)
class ComparedRuns:
    """Runs of one scenario with several laws, in the requested order.

    Attributes:
        runs: a run for each law.
        settling: results of starts with small and large errors, for each tested law.
    """

    runs: list[JudgedRun]
    settling: list[SettlingTest] = field(default_factory=list)

    @property
    def drawn(self) -> list[JudgedRun]:
        """Runs that can be drawn."""
        return [run for run in self.runs if len(run.data.tables[topics.PLANT_TRUTH.name]) > 1]

    def colour_index(self, law: str) -> int:
        """Return the index of a law among all, which selects its colour."""
        return [run.law for run in self.runs].index(law)


def compared_in(path: Path, summary: Mapping[str, Any]) -> ComparedRuns:
    """Return the runs in the folder of a comparison, judged again.

    Args:
        path: the folder.
        summary: its summary of the comparison.

    Raises:
        RunFolderError: a run is missing or cannot be read.
    """
    laws = summary.get("laws")
    if not isinstance(laws, dict):
        raise run_folder.RunFolderError(f"{path / 'summary.json'}: names no laws")
    runs = [judged_again(law, path / law_folder(law)) for law in laws]
    return ComparedRuns(runs, SETTLING.validate_python(summary.get("settling", [])))


def rows_again(compared: ComparedRuns, before: Sequence[Row]) -> list[Row]:
    """Return the rows of a comparison whose recordings were judged again, in order.

    Args:
        compared: its runs.
        before: the existing rows, with those of starts, which have no recording.
    """
    starts = [each for each in before if each.get("offset_rad") is not None]
    of_law = {each["law"]: each for each in before if each not in starts}
    rows = [
        {**of_law.get(run.law, {}), **row(run.result, run.seed), "point": f"{index:03d}",
         "offset_rad": None}
        for index, run in enumerate(compared.runs)
    ]  # fmt: skip
    return sorted([*rows, *starts], key=lambda each: str(each["point"]))


def law_folder(law: str) -> str:
    """Return the folder of a law's run in a comparison."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", law)


def judged_again(name: str, path: Path) -> JudgedRun:
    """Return a recorded run, with facts that only its folder contains.

    Raises:
        RunFolderError: it cannot be read.
    """
    data, _ = run_folder.load_run(path)
    confirmed = run_folder.read_summary(path).get(CONFIRMATION)
    return JudgedRun(name, data, judge(data).replaced(confirmation=confirmed), path)
