"""Tuning: one search for the gains of every law, then a verdict where nothing was tuned."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import InputError, did_you_mean
from controller.laws import LAWS
from controller.laws.custom import EXTERNAL, default_gains
from controller.policies.configuration import is_address
from deploy.judge.conditions import Conditions
from deploy.judge.run_rows import Row
from deploy.scenario import study_keys
from deploy.scenario.effective import write_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import naming, override, plain, validated
from deploy.studies.tune.costs import UNFINISHED, delay_cost, error_cost
from deploy.studies.tune.gain_search import FIXED, Gains, GainSearch
from deploy.studies.tune.result import Judged, TunedLaw, TuneResult
from deploy.studies.tune.runs import REAL_ARM, TuneDefinition, judged, searched
from deploy.study.definition import scenario_name
from deploy.study.execution.growth import may_rise
from deploy.study.planned_run import PlannedRun
from deploy.study.plants import draw_columns, with_ranges
from deploy.study.statistics import kept_up_to
from deploy.study.study import StudyOfRuns, rows_by

_QUARTER = 4
_CONVERGED, _NARROW = 0.02, 0.15
"""A search has converged if its last quarter gained less than this, and its spread is half of what
it was at first."""


@dataclass
class _Law:
    """A law with its search.

    Attributes:
        rows: of candidates, by their number.
        judged: rows of the verdict, by whether the gains are those that were found.
    """

    name: str
    setup: Setup
    search: GainSearch
    rows: dict[int, list[Row]] = field(default_factory=dict)
    judged: dict[int, list[Row]] = field(default_factory=dict)

    def gains(self, which: int) -> Gains:
        """Return the gains of the start (0), or those that were found (1)."""
        return self.search.candidates[self.search.best if which else 0]

    @property
    def judged_gains(self) -> list[int]:
        return [0] if self.search.best == 0 else [0, 1]


class Tuning(StudyOfRuns):
    """The runs of a search for the gains of laws, and of the verdict.

    Attributes:
        places: where the search runs, and where its results are judged.
    """

    kind = "tune"
    growth = MappingProxyType({**StudyOfRuns.growth, "budget": may_rise})
    definition: TuneDefinition

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        values = {"name": "tune", "plants": 3, "uncertainty": "half", **values}
        given = validated(with_ranges(values, source), TuneDefinition, source)
        with naming(source):
            own = {study_keys.LAW: "as laws (--laws)", study_keys.SEED: "under seeds"}
            own |= dict.fromkeys(study_keys.DELAYS, "as delays (--delays with --for margin)")
            study_keys.require_effect(given.fixed, own)
            scenario = scenario_name(given.scenario, source.parent)
        self.definition = given.model_copy(update={"scenario": scenario})
        self.columns = {
            "law": "string", "stage": "string", "place": "string", "gains": "string",
            "offset_scale": "double", "round_trip_ms": "double",
        }  # fmt: skip
        setups = {law: load_setup(scenario, self._under(law)) for law in given.laws}
        self.bases = list(setups.values())
        with naming(source):
            study_keys.require_link_effect(given.fixed, self.bases)
            self.columns |= draw_columns(given, self.bases[:1])
            _require_rising(given.ranges)
            self._laws = [self._begun(law, setup) for law, setup in setups.items()]
            _require_known(given.ranges, self._laws)
        self.places = {"search": searched(given), "judge": judged(self.definition, self.bases[0])}

    @property
    def laws(self) -> list[str]:
        return self.definition.laws

    def _under(self, law: str) -> list[str]:
        return [*self.definition.fixed_overrides, override(study_keys.LAW, law)]

    def _begun(self, law: str, setup: Setup) -> _Law:
        wanted = self.definition
        try:
            start = _start_of(law, setup)
            fixed = FIXED - {"boundary_layer"} if wanted.travel_limit_per_s else FIXED
            search = GainSearch(start, wanted.budget, wanted.search_seed, wanted.ranges, fixed)
        except InputError as error:
            raise ConfigurationError("laws", law, "; ".join(error.args)) from error
        return _Law(law, setup, search)

    @property
    def expected(self) -> int:
        searched = self.definition.budget * len(self.places["search"])
        per_law = searched + 2 * len(self.places["judge"])
        same = sum(law.search.is_over and not law.search.best for law in self._laws)
        seeds = len(self.definition.seeds)
        return seeds * (per_law * len(self._laws) - same * len(self.places["judge"]))

    def first(self) -> Iterable[PlannedRun]:
        return [run for index in range(len(self._laws)) for run in self._candidate(index, 0)]

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        index, number, _ = run.point.split("-")
        law = self._laws[int(index)]
        if run.columns["stage"] == "judge":
            law.judged.setdefault(int(number[1:]), []).append(values)
            return []
        law.rows.setdefault(int(number), []).append(values)
        known, asked = len(law.search.costs), len(law.search.candidates)
        needed = len(self.places["search"]) * len(self.definition.seeds)
        if any(len(law.rows.get(each, ())) < needed for each in range(known, asked)):
            return []
        law.search.tell([self._cost(law, law.rows[each]) for each in range(known, asked)])
        if law.search.is_over:
            return [r for which in law.judged_gains for r in self._verdict(int(index), which)]
        new = range(asked, len(law.search.candidates))
        return [one for each in new for one in self._candidate(int(index), each)]

    def _candidate(self, index: int, number: int) -> list[PlannedRun]:
        gains = self._laws[index].search.candidates[number]
        return list(self._runs(index, f"{number:04d}", gains, "search"))

    def _verdict(self, index: int, which: int) -> list[PlannedRun]:
        return list(self._runs(index, f"j{which}", self._laws[index].gains(which), "judge"))

    def _runs(self, index: int, number: str, gains: Gains, stage: str) -> Iterator[PlannedRun]:
        wanted, law = self.definition, self._laws[index].name
        known = dict.fromkeys(self.columns) | {
            "law": law, "stage": stage, "gains": json.dumps(gains, sort_keys=True),
        }  # fmt: skip
        full_s = self._laws[index].setup.scenario.duration_s
        duration_s = min(wanted.duration_s, full_s) if stage == "search" else full_s
        # First, so that values of the user and of drawn plants take precedence.
        common = (
            *REAL_ARM, *self._under(law),
            override(f"controller.gains.{study_keys.gains_key(law)}", gains),
            *_lasting(duration_s, self._laws[index].setup),
        )  # fmt: skip
        beyond = 0 if stage == "search" else max(wanted.seeds)
        for place_number, place in enumerate(self.places[stage]):
            for seed in wanted.seeds:
                yield PlannedRun(
                    f"{index:02d}-{number}-{place_number:03d}", wanted.scenario,
                    (*common, *place.overrides), seed + beyond,
                    {**known, **place.columns, "place": place.name},
                    ends_early=wanted.goal == "margin",
                )  # fmt: skip

    def _cost(self, law: _Law, rows: Sequence[Row]) -> float:
        if self.definition.goal == "margin":
            duration_s = min(self.definition.duration_s, law.setup.scenario.duration_s)
            return delay_cost(rows, duration_s) / len(self.definition.seeds)
        limit = self.definition.travel_limit_per_s
        return float(np.mean([error_cost(row, law.setup, limit) for row in rows]))

    def findings(self, rows: list[Row]) -> dict[str, Any]:
        wanted = self.definition
        return TuneResult(
            scenario=self.bases[0].scenario.name, goal=wanted.goal, budget=wanted.budget,
            search_seed=wanted.search_seed, travel_limit_per_s=wanted.travel_limit_per_s,
            delays_ms=wanted.delays_ms if wanted.goal == "margin" else None,
            joint_names=list(self.bases[0].robot.joint_names),
            completed=len(rows) >= self.expected, runs_expected=self.expected,
            laws={law.name: self._found(law) for law in self._laws if law.search.costs},
        ).to_json()  # fmt: skip

    def _found(self, law: _Law) -> TunedLaw:
        search, costs = law.search, law.search.costs
        best = np.minimum.accumulate(costs)
        late = len(best) - 1 - len(best) // _QUARTER
        gained = float(best[late] - best[-1])
        is_settled = gained < _CONVERGED and search.spread < _NARROW
        return TunedLaw(
            candidates=len(costs), cost_start=costs[0], cost_found=float(best[-1]),
            best_candidate=search.best, history=best.tolist(), gained_in_last_quarter=gained,
            spread=search.spread,
            converged=bool(search.is_over and best[-1] < UNFINISHED and is_settled),
            gains={"start": law.gains(0), "found": law.gains(1)},
            judged={
                name: self._verdict_of(law, which)
                for which, name in enumerate(("start", "found"))
                if (which if which in law.judged_gains else 0) in law.judged
            },
        )  # fmt: skip

    def _verdict_of(self, law: _Law, which: int) -> list[Judged]:
        """Return what became of the runs with these gains, a part for each place."""
        found = []
        by_place = rows_by(law.judged[min(which, max(law.judged))], lambda row: row["place"])
        for name in dict.fromkeys(place.name for place in self.places["judge"]):
            own = by_place.get(name, [])
            rms = [row["rms_rad"] for row in own if row["rms_rad"] is not None]
            one = Judged(place=name, runs=len(own), kept=sum(map(_is_kept, own)))
            if self.definition.goal == "rms":
                one.rms_rad = np.max(rms, axis=0).tolist() if rms else None
            else:
                delays_ms = sorted(self.definition.delays_ms)
                one.kept_up_to_ms = kept_up_to(own, "round_trip_ms", delays_ms, _is_kept)
            found.append(one)
        return found

    def keep_files(self, summary: dict[str, Any], folder: Path) -> None:
        """Write a scenario for each law with the gains that were found."""
        files = list[str]()
        for law in self._laws:
            if law.name not in summary["laws"]:
                continue
            gains = override(f"controller.gains.{study_keys.gains_key(law.name)}", law.gains(1))
            name = override("name", f"{summary['scenario']}-{_file(law.name)}")
            path = folder / f"{_file(law.name)}.yaml"
            overrides = [*self._under(law.name), gains, name]
            write_scenario(load_setup(self.definition.scenario, overrides), path)
            summary["laws"][law.name]["file"] = path.name
            files.append(path.name)
        summary["files"] = files

    def conditions(self, summary: Mapping[str, Any], manifest: Mapping[str, Any]) -> Conditions:
        wanted = self.definition
        trips_ms = wanted.delays_ms if wanted.goal == "margin" else [1.0]
        what = (
            f"gains for {wanted.goal}, {wanted.budget} candidates for each law, search seed"
            f" {wanted.search_seed}, runs of up to {wanted.duration_s:g} s"
        )
        full_s = self.bases[0].scenario.duration_s
        judged_at = ", ".join(dict.fromkeys(place.name for place in self.places["judge"]))
        axes = [{"keys": ["gains"], "values": [what]}]
        found = super().conditions({**summary, "axes": axes}, manifest)
        return {
            **found,
            "duration": f"{min(wanted.duration_s, full_s):g} s in the search, {full_s:g} s judged",
            "arm": "encoders of 20 bits, unless given",
            "round trip": f"{', '.join(f'{each:g}' for each in trips_ms)} ms",
            "judged at": f"{judged_at}, over the whole scenario",
        }


def _lasting(duration_s: float, setup: Setup) -> list[str]:
    from_s = min(setup.scenario.metrics.from_s, 0.5 * duration_s)
    return [f"duration_s={duration_s}", f"metrics.from_s={from_s}"]


def _start_of(law: str, setup: Setup) -> Gains:
    """Return the gains that a scenario gives, or that a law has by itself."""
    if law == EXTERNAL or is_address(law):
        raise InputError("has no gains here: must be a law, not a program or a server")
    given = plain(setup.gains)
    return given if law in LAWS else {**default_gains(law), **given}


def _file(law: str) -> str:
    return law.replace(":", "_").replace(".", "_")


def _is_kept(row: Row) -> bool:
    return bool(row["bounds_kept"]) and row["error"] is None


def _require_rising(ranges: Mapping[str, tuple[float, float]]) -> None:
    for name, (low, high) in ranges.items():
        if not low < high:
            raise ConfigurationError(f"ranges.{name}", [low, high], "must rise")


def _require_known(ranges: Iterable[str], laws: Iterable[_Law]) -> None:
    known = {name for law in laws for name in law.search.candidates[0]}
    for name in ranges:
        if name not in known:
            hint = did_you_mean(name, sorted(known))
            raise ConfigurationError("ranges", name, f"no law has such a gain{hint}")
