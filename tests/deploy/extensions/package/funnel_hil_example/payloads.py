"""A kind of study: the heaviest of some payloads with which a law keeps its bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from deploy.judge.gate import Finite, Gauged
from deploy.judge.run_rows import Row, held
from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.gauges import GaugedSummary
from deploy.reports.kinds import ResultKind
from deploy.reports.page import Fact, Page, ReportHead, level_of
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import override, validated
from deploy.study.definition import StudyDefinition, scenario_name
from deploy.study.planned_run import PlannedRun
from deploy.study.study import StudyOfRuns, shown_value


class PayloadsDefinition(StudyDefinition):
    """Definition, as in its YAML file.

    Attributes:
        scenario: a scenario file, relative to this one, or the name of a shipped one.
        payloads_kg: the payloads to try.
    """

    scenario: str
    payloads_kg: list[float]


class Payloads(StudyOfRuns):
    """The runs: each payload with each seed."""

    kind = "payloads"
    unit = "kg"
    definition: PayloadsDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        given = validated(values, PayloadsDefinition, source)
        scenario = scenario_name(given.scenario, source.parent)
        self.definition = given.model_copy(update={"scenario": scenario})
        self.bases = [load_setup(scenario, given.fixed_overrides, "set")]
        self.columns = {"payload_kg": "double"}

    def first(self) -> Iterable[PlannedRun]:
        wanted = self.definition
        for index, kg in enumerate(wanted.payloads_kg):
            overrides = (*wanted.fixed_overrides, override("plant.payload_kg", kg))
            for seed in wanted.seeds:
                point = f"{index:03d}"
                yield PlannedRun(point, wanted.scenario, overrides, seed, {"payload_kg": kg})

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        tried = self.definition.payloads_kg
        lost = {row["payload_kg"] for row in rows if not held(row)}
        axis = {"keys": ["plant.payload_kg"], "values": tried}
        return {
            "scenario": self.bases[0].scenario.name,
            "completed": len(rows) == self.expected,
            "axes": [axis],
            "heaviest_kg": max((kg for kg in tried if kg not in lost), default=None),
            "lost": len(lost),
        }


class GaugedPayloads(GaugedSummary):
    """The number that a gate reads: the heaviest payload."""

    group = "payloads"
    scenario: str
    heaviest_kg: Finite | None

    def numbers(self) -> Iterator[Gauged]:
        yield Gauged(self.scenario, self.heaviest_kg, "kg")


def payloads_page(study: DrawnStudy) -> Page[DrawnStudy]:
    """Return the page of a study."""
    summary, tried = study.summary, len(study.summary["axes"][0]["values"])
    text = f"{shown_value(summary['heaviest_kg'])} kg is the heaviest payload that kept the bounds"
    head = ReportHead(level_of(tried - summary["lost"], tried), text, [])
    facts = [Fact("Scenario", summary["scenario"])]
    return Page("payloads", summary["name"], head, facts, list, study)


PAYLOADS = ResultKind(Payloads.kind, GaugedPayloads, Payloads, payloads_page)
