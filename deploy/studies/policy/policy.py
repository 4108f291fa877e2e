"""The study of a policy: every merge of its chunks at rising inference times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from bus_schema.configuration import ConfigurationError, NonNegative, Positive, Whole
from controller.chunks.configuration import CHUNK_MERGES
from deploy.judge.gate import Gauged
from deploy.judge.run_rows import Row, reason_of, tolerated
from deploy.scenario import study_keys
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming, override, validated
from deploy.studies.policy.findings import merge_findings
from deploy.studies.policy.result import Alone, PolicyResult
from deploy.study.definition import (
    Different,
    StudyDefinition,
    require_own_names,
    scenario_name,
)
from deploy.study.planned_run import PlannedRun
from deploy.study.study import StudyOfRuns, rows_by
from plant_emulator.interfaces.settings import TORQUE

INFERENCE, MERGE, TASK = "controller.inference_ms", "controller.chunks.merge", "reference.task"
_MOST_TIMES = 1000
_ALONE = "-alone"
"""End of the name of a run without the study's network."""
_YAML = (".yaml", ".yml")
_OF_ARM_FILES: dict[str, Any] = {
    "plant.interface": {"kind": "servoj", "servoj": {"lookahead_time_s": 0.03, "gain": 1200}},
    "controller.between_answers": "linear",
    "controller.chunks": {"horizon": 16, "period_ms": 40, "ask_every": 6},
    "funnel": {"final_rad": 0.08, "convergence_margin_rad": 0.08, "overshoot_margin_rad": 0.08},
    "metrics.from_s": 1.0,
}
"""Values for the file of an arm, which says nothing of the robot's interface and of chunks."""


def usual_merges() -> list[str]:
    """Return the merges to try by default: those that ship and do not wait."""
    return [name for name in CHUNK_MERGES.shipped if name != "synchronous"]


class PolicyDefinition(StudyDefinition):
    """Settings of a study of a policy.

    Attributes:
        scenarios: scenarios, or files of arms: those get ``servoj`` and chunks of 16 actions at
            25 Hz, a new one asked for every 6 actions, unless `fixed` has others.
        law: the policy; null for that of each scenario.
        merges: names of the merges to try; those that ship and do not wait by default.
        network: a file of delays, or the name of a shipped trace; null for the scenario's link.
        at_ms: inference time at which jumps, jerk and ages are compared.
        limit_ms: the largest inference time tried.
        resolution_ms: from one inference time to the next.
        tasks: number of tasks of a reference that draws them; null for the scenario's own.
    """

    scenarios: Different[str]
    law: str | None = None
    merges: Different[str] = Field(default_factory=usual_merges)
    network: str | None = None
    at_ms: NonNegative = 100.0
    limit_ms: Annotated[Positive, Field(le=10_000)] = 300.0
    resolution_ms: Positive = 25.0
    tasks: Annotated[Whole, Field(ge=1, le=1000)] | None = None


class Case(NamedTuple):
    """A merge on an arm, and the inference times that are tried with it."""

    scenario: str
    arm: str
    merge: str
    times_ms: list[float]
    is_whole: bool
    """Whether these reach the limit, as not all merges can work with any inference time."""


class PolicyStudy(StudyOfRuns):
    """The runs of a study of a policy.

    Attributes:
        cases: merges on arms.
    """

    kind = "policy"
    definition: PolicyDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        given = validated({"name": "policy", **values}, PolicyDefinition, source)
        with naming(source):
            for merge in given.merges:
                CHUNK_MERGES.check(merge)
            own = {study_keys.SEED: "as seeds", INFERENCE: "as limit_ms", MERGE: "as merges"}
            own |= {TASK: "as tasks"} if given.tasks else {}
            study_keys.require_effect(given.fixed, own)
            names = [scenario_name(each, source.parent) for each in given.scenarios]
            self.definition = given.model_copy(update={"scenarios": names})
            self.columns = {
                "arm": "string", "merge": "string", "inference_ms": "double", "task": "int64",
            }  # fmt: skip
            if given.limit_ms > _MOST_TIMES * given.resolution_ms:
                least_ms = given.limit_ms / _MOST_TIMES
                allowed = f"must be at least limit_ms / {_MOST_TIMES} = {least_ms:g}"
                raise ConfigurationError("resolution_ms", given.resolution_ms, allowed)
            self.cases = [self._case(name, merge) for name in names for merge in given.merges]
            require_own_names((case.arm, case.scenario) for case in self.cases)
            self._variants = [self._setup(each.scenario, each.merge, 0.0) for each in self.cases]
            self.bases = self._variants[:: len(given.merges)]
            self._shortest: dict[str, list[tuple[PlannedRun, Row]]] = {}
            self._alone: set[str] = set()

    @property
    def variants(self) -> list[Setup]:
        return self._variants

    @property
    def unit(self) -> str:
        return "ms"

    @property
    def furthest(self) -> Gauged:
        """The longest inference time that is tried."""
        return Gauged("the last value tried (--limit)", self.definition.limit_ms, self.unit)

    @property
    def own_test(self) -> dict[str, Any]:
        keys = {"network", "at_ms", "limit_ms", "resolution_ms", "tasks"}
        return {**super().own_test, **self.definition.model_dump(include=keys)}

    def first(self) -> Iterable[PlannedRun]:
        wanted = self.definition
        for number, case in enumerate(self.cases):
            for time_ms in case.times_ms:
                for task in self._tasks:
                    columns = {
                        "arm": case.arm, "merge": case.merge, "inference_ms": time_ms, "task": task,
                    }  # fmt: skip
                    point = f"{number:03d}-{round(1e3 * time_ms):08d}-{task or 0:04d}"
                    overrides = self._overrides(case.scenario, case.merge, time_ms, task)
                    for seed in wanted.seeds:
                        yield PlannedRun(
                            point, case.scenario, overrides, seed, columns, bool(wanted.confirm),
                            ends_early=time_ms > case.times_ms[0],  # the first is quoted if lost
                        )  # fmt: skip

    @property
    def expected(self) -> int:
        return super().expected + len(self._alone)

    @property
    def at_most(self) -> int:
        needed = len(self.definition.merges) * len(self._tasks) * len(self.definition.seeds)
        open_ = sum(len(self._shortest.get(base.scenario.name, ())) < needed for base in self.bases)
        return self.expected + open_ * (self.definition.network is not None)

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        """Request one run without the network where no merge holds at the shortest time."""
        wanted, time_ms = self.definition, self.cases[int(run.point[:3])].times_ms[0]
        if wanted.network is None or run.point.endswith(_ALONE):
            return ()
        if run.columns["inference_ms"] != time_ms:
            return ()
        known = self._shortest.setdefault(run.columns["arm"], [])
        known.append((run, values))
        if len(known) < len(wanted.merges) * len(self._tasks) * len(wanted.seeds):
            return ()
        of_merge = rows_by(known, lambda each: each[1]["merge"])
        if any(all(tolerated(row) for _, row in each) for each in of_merge.values()):
            return ()
        lost = min((one for one, row in known if not tolerated(row)), key=lambda one: one.key)
        self._alone.add(run.columns["arm"])
        merge, task = lost.columns["merge"], lost.columns["task"]
        overrides = self._overrides(lost.scenario, merge, time_ms, task, has_network=False)
        return [replace(lost, point=lost.point + _ALONE, overrides=overrides)]

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        alone = [row for row in rows if row["point"].endswith(_ALONE)]
        wanted, count = self.definition, len(rows)
        rows = [row for row in rows if row not in alone]
        of_case = rows_by(rows, lambda row: (row["arm"], row["merge"]))
        return PolicyResult(
            completed=count == self.expected, title="inference time", unit="ms",
            values=sorted({time_ms for case in self.cases for time_ms in case.times_ms}),
            policy=", ".join(self.laws), network=wanted.network, at_ms=wanted.at_ms,
            limit_ms=wanted.limit_ms, tasks=wanted.tasks,
            without_network=[
                Alone(arm=each["arm"], merge=each["merge"], held=tolerated(each),
                      ends=reason_of(each))
                for each in alone
            ],
            torque_arms=[each.scenario.name for each in self.bases if _sends_torques(each)],
            cases=[
                merge_findings(
                    case.arm, case.merge, of_case.get((case.arm, case.merge), []), case.times_ms,
                    wanted.at_ms, is_whole=case.is_whole,
                )
                for case in self.cases
            ],
        ).to_json()  # fmt: skip

    @property
    def _tasks(self) -> Sequence[int | None]:
        count = self.definition.tasks
        return [None] if count is None else range(1, count + 1)

    def _case(self, scenario: str, merge: str) -> Case:
        """Return the inference times of a merge, and check its ends.

        Raises:
            ScenarioError: the scenario refuses them.
        """
        wanted, base = self.definition, self._setup(scenario, merge, 0.0)
        chunks = base.scenario.controller.chunks
        assert chunks is not None  # as its merge is set
        controller = base.scenario.controller
        if not controller.knows_inference_time:
            allowed = "must be configured: this study chooses the inference time"
            raise ConfigurationError("controller.policy_server.inference", "measured", allowed)
        longest_ms = 1e3 * chunks.longest_inference_s(1e-9 * base.grid.period_ns)
        limit_ms = min(wanted.limit_ms, longest_ms)
        count = math.floor(limit_ms / wanted.resolution_ms + 1e-9)
        steps_ms = {round(k * wanted.resolution_ms, 9) for k in range(count + 1)}
        times_ms = sorted(steps_ms | {round(limit_ms, 9), min(wanted.at_ms, round(limit_ms, 9))})
        self._setup(scenario, merge, times_ms[-1])
        is_whole = longest_ms >= wanted.limit_ms
        return Case(scenario, base.scenario.name, merge, times_ms, is_whole)

    def _setup(self, scenario: str, merge: str, inference_ms: float) -> Setup:
        last = self._tasks[-1]
        return load_setup(scenario, self._overrides(scenario, merge, inference_ms, last))

    def _overrides(
        self, scenario: str, merge: str, inference_ms: float, task: int | None, *,
        has_network: bool = True,
    ) -> tuple[str, ...]:  # fmt: skip
        wanted = self.definition
        usual: tuple[str, ...] = ()
        if Path(scenario).suffix and not scenario.endswith(_YAML):
            usual = tuple(override(key, value) for key, value in _OF_ARM_FILES.items())
        network = wanted.network if has_network else None
        traces = {} if network is None else dict.fromkeys(study_keys.TRACES, network)
        law = {} if wanted.law is None else {study_keys.LAW: wanted.law}
        tasks = {} if task is None else {TASK: task}
        values = {**traces, **law, MERGE: merge, INFERENCE: inference_ms, **tasks}
        own = (override(key, value) for key, value in values.items())
        return (*usual, *wanted.fixed_overrides, *own)


def _sends_torques(setup: Setup) -> bool:
    """Whether torques go over the link, so that a late one acts in a wrong state."""
    scenario = setup.scenario
    is_loop = scenario.controller.drive_feedback.enabled
    return scenario.plant.interface.takes == TORQUE and not is_loop
