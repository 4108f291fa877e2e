"""Cells of a benchmark: a law with a predictor and gains on an arm, and where each is run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field

from bus_schema.configuration import Positive, Whole
from bus_schema.errors import did_you_mean
from bus_schema.user_files import read_text
from controller.compensation.delay_compensation import (
    ADAPTIVE,
    COMMUNICATION_DISTURBANCE_OBSERVER,
    PREDICTORS,
)
from deploy.reports.gauges import Part
from deploy.scenario import study_keys
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, override
from deploy.studies.tune.runs import REAL_ARM
from deploy.study.definition import Different
from deploy.study.follow_ups.patterns import HANDFUL
from deploy.study.plants import UncertainDefinition, draw_plants
from deploy.study.settings import COMPENSATION

NO_PREDICTOR = "none"
BENCHMARK_ARMS = ("paper_arm", "panda_motors", "ur10e_motors", "iiwa_motors")
BENCHMARK_PREDICTORS = (NO_PREDICTOR, ADAPTIVE, "smith", COMMUNICATION_DISTURBANCE_OBSERVER)
BENCHMARK_DELAYS_MS = (1.0, 4.0, 8.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0)
"""Default predictors and delays of a benchmark."""
PREDICTOR = "controller.delay_compensation.predictor"
_PATTERNS = ("link.uplink.pattern", "link.downlink.pattern")
GIVEN, TUNED = "given", "tuned"
CONSTANT, PATTERN, NETWORK, PLANTS = "constant", "pattern", "network", "plants"
"""Conditions of a cell: constant delays, the same as patterns, networks, and other plants."""


class BenchmarkDefinition(UncertainDefinition):
    """Settings of a benchmark.

    Attributes:
        scenarios: the arms: scenario files, or names of shipped ones.
        laws: the laws.
        predictors: delay compensation: ``none``, or the predictors of scenarios.
        gains: gains that were found, by scenario and law; a law without them is run once, with
            those of the scenario or those that it derives.
        delays_ms: round trips, tried in this order until the first loss.
        networks: names of shipped traces, or files of delays.
        windows: number of windows of each network.
        duration_s: length of each run.
    """

    scenarios: Different[str]
    laws: Different[str]
    predictors: Different[str]
    gains: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    delays_ms: Different[Positive]
    networks: list[str] = Field(default_factory=list)
    windows: Annotated[Whole, Field(ge=1, le=1000)] = 4
    duration_s: Positive = 6.0


class Cell(Part):
    """A law with a predictor, on an arm, with given or tuned gains."""

    scenario: str
    law: str
    predictor: str
    gains: str

    def overrides(self, found: Mapping[str, Any]) -> tuple[str, ...]:
        """Return its overrides; `found` are the gains of its law, for tuned ones."""
        texts = [*REAL_ARM, override(study_keys.LAW, self.law)]
        texts.append(override(COMPENSATION, self.predictor != NO_PREDICTOR))
        if self.predictor != NO_PREDICTOR:
            texts.append(override(PREDICTOR, self.predictor))
        if self.gains == TUNED:
            texts.append(override(f"controller.gains.{study_keys.gains_key(self.law)}", found))
        return tuple(texts)


class Place(NamedTuple):
    """A row of runs of a cell: one for each delay until the first loss, or a single one.

    Attributes:
        condition: one of `CONSTANT`, `PATTERN`, `NETWORK` and `PLANTS`.
        overrides: without the delay.
        columns: values that identify it.
        has_delays: whether a delay is varied.
        window: number of the window of a network; windows and seeds share no seed of a run.
    """

    condition: str
    overrides: tuple[str, ...]
    columns: Mapping[str, Any]
    has_delays: bool = True
    window: int = 0


def cells_of(wanted: BenchmarkDefinition) -> list[Cell]:
    """Return all cells of a benchmark.

    Raises:
        ScenarioError: a predictor is unknown.
    """
    known = [NO_PREDICTOR, *PREDICTORS]
    for predictor in wanted.predictors:
        if predictor not in known:
            allowed = f"must be one of {', '.join(known)}{did_you_mean(predictor, known)}"
            raise ScenarioError(f"predictors = {predictor}: {allowed}")
    return [
        Cell(scenario=scenario, law=law, predictor=predictor, gains=gains)
        for scenario in wanted.scenarios
        for law in wanted.laws
        for predictor in wanted.predictors
        for gains in ([GIVEN, TUNED] if law in wanted.gains.get(scenario, {}) else [GIVEN])
    ]


def places_of(wanted: BenchmarkDefinition, base: Setup, cell: Cell) -> list[Place]:
    """Return where a cell is run, the constant delay first.

    Commands of compensated cells act when they say, so that no pattern below a delay changes their
    motion: these have no runs of patterns.
    """
    places = [Place(CONSTANT, (), {})]
    if cell.predictor == NO_PREDICTOR:
        for pattern in HANDFUL:
            texts = tuple(override(key, pattern) for key in _PATTERNS)
            places.append(Place(PATTERN, texts, {"pattern": json.dumps(pattern)}))
    for network in wanted.networks:
        texts = tuple(override(key, network) for key in study_keys.TRACES)
        for window in range(wanted.windows):
            columns = {"network": network, "window": float(window)}
            places.append(Place(NETWORK, texts, columns, has_delays=False, window=window))
    if wanted.plants is not None:
        drawn = draw_plants(wanted, base, [study_keys.LAW, study_keys.SEED, *study_keys.DELAYS])
        places += [Place(PLANTS, each.overrides, each.columns) for each in drawn]
    return places


def tuned_gains(folders: list[Path]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the gains that `tune` found, by scenario and law.

    Raises:
        ScenarioError: a folder holds no finished result of `tune`.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for folder in folders:
        file = folder / "summary.json"
        try:
            summary = json.loads(read_text(file))
            is_finished = summary["kind"] == "tune" and summary["completed"]
            laws = {law: each["gains"]["found"] for law, each in summary["laws"].items()}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ScenarioError(f"--tuned {file}: must be the result of tune: {error}") from error
        if not is_finished:
            raise ScenarioError(f"--tuned {file}: must be a finished result of tune")
        found.setdefault(summary["scenario"], {}).update(laws)
    return found
