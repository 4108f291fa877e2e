"""Inference times that a policy may take with each merge of its chunks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from controller.chunks.configuration import CHUNK_MERGES
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import LAW
from deploy.scenario.yaml_files import override
from deploy.studies.margin.margin_study import margin_study
from deploy.study.study import StudyOfRuns

INFERENCE, MERGE = "controller.inference_ms", "controller.chunks.merge"
_TRACES = ("link.uplink.trace.file", "link.downlink.trace.file")
_SOURCE = Path("policy")


@dataclass(frozen=True)
class PolicySheet:
    """Settings of a search over merges.

    Attributes:
        arm: a scenario, or the file of an arm.
        law: the policy.
        merges: names of the merges to try.
        network: a file of delays, or the name of a shipped trace; None for the scenario's link.
        at_ms: inference time at which jumps and ages are compared.
        limit_ms: the largest inference time tried.
        resolution_ms: of the largest inference times found.
        fixed: values of the scenario, by dotted key.
    """

    arm: str
    law: str
    merges: Sequence[str]
    network: str | None
    at_ms: float
    limit_ms: float
    resolution_ms: float
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def _set(self, merge: str) -> dict[str, Any]:
        traces = {} if self.network is None else dict.fromkeys(_TRACES, self.network)
        return {**traces, **self.fixed, MERGE: merge}

    def margin(self, merge: str) -> StudyOfRuns:
        """Return the search for the largest inference time with a merge; raises as `settings`."""
        values = {
            "name": f"policy_{merge}", "scenarios": [self.arm], "laws": [self.law],
            "running": [False], "quantity": INFERENCE, "limit": self.limit_of(merge),
            "resolution": self.resolution_ms, "offsets": [1.0], "seeds": [1],
            "set": self._set(merge),
        }  # fmt: skip
        return margin_study(values, _SOURCE)

    def limit_of(self, merge: str) -> float:
        """Return the largest inference time to try with a merge, ms; raises ScenarioError."""
        base = self._setup(merge, 0.0)
        chunks = base.scenario.controller.chunks
        assert chunks is not None  # as its merge is set
        longest_ms = 1e3 * chunks.longest_inference_s(1e-9 * base.grid.period_ns)
        return min(self.limit_ms, longest_ms)

    def setup(self, merge: str) -> Setup:
        """Return the scenario of the run in which merges are compared; raises ScenarioError."""
        return self._setup(merge, min(self.at_ms, self.limit_of(merge)))

    def _setup(self, merge: str, inference_ms: float) -> Setup:
        values = {**self._set(merge), LAW: self.law, INFERENCE: inference_ms}
        return load_setup(self.arm, [override(key, value) for key, value in values.items()])

    def compared(self, merge: str) -> dict[str, Any]:
        """Return what a run with a merge says of its chunks."""
        found = summarise(simulate(self.setup(merge)).data())
        tip, chunks = found["tip_error_mm"], found["chunks"] or {}
        ages = chunks.get("age_ms") or {}
        return {
            "verdict": found["verdict"], "jump_rad": _seen(chunks.get("jump_rad")),
            "jump_mm": _seen(chunks.get("jump_mm")), "age_median_ms": ages.get("median"),
            "age_largest_ms": ages.get("largest"), "starved_share": chunks.get("starved_share"),
            "tip_error_rms_mm": tip["rms"],
        }  # fmt: skip


def _seen(value: float | None) -> float | None:
    """Return a value without what arithmetic alone leaves of zero."""
    return None if value is None else round(value, 9)


def shipped_merges() -> list[str]:
    """Return the merges to try by default: those that ship, can be used, and do not wait."""
    return [name for name in CHUNK_MERGES.shipped if name != "synchronous"]


def recommended(rows: Sequence[Mapping[str, Any]]) -> str | None:
    """Return the merge that tolerates most, and of equals jumps least; None if none does."""
    able = [row for row in rows if row["inference_ms"] is not None]
    if not able:
        return None
    best = max(able, key=lambda row: (row["inference_ms"], -(row["jump_rad"] or 0.0)))
    name: str = best["merge"]
    return name
