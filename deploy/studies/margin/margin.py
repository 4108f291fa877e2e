"""Margins: how much delay, jitter, loss or other quantity a law tolerates within its bounds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from bus_schema.configuration import ConfigurationError, Number, Positive
from controller.laws.custom import is_custom
from deploy.judge.run_rows import Row, tolerated, uses_seed
from deploy.scenario.checking.warnings import require_hold
from deploy.scenario.scenario import load_setup
from deploy.scenario.study_keys import UNCERTAINTY
from deploy.scenario.yaml_files import override
from deploy.studies.margin.findings import search_findings
from deploy.study.cases import CASE_COLUMNS, Case, StudyOfCases
from deploy.study.definition import Different, Seeds
from deploy.study.follow_ups import disturbances, remedies, unknowns
from deploy.study.follow_ups.disturbances import DisturbanceSizes
from deploy.study.follow_ups.expected_loss import first_loss, theory_beside
from deploy.study.follow_ups.pattern_trace import write_worst_traces
from deploy.study.follow_ups.patterns import HANDFUL, PatternSearch, shaped
from deploy.study.follow_ups.patterns import variants_at_most as patterns_at_most
from deploy.study.follow_ups.trials import COLUMN, Changes, Trials, changed, trials
from deploy.study.margin_search import PARTS, MarginSearch, Steps
from deploy.study.planned_run import PlannedRun
from deploy.study.plants import Variant
from deploy.study.quoted import quoted
from deploy.study.settings import CasesDefinition, Setting
from deploy.study.study import ONE_START
from deploy.study.trials.sequential_test import SequentialTest

_OF_PATTERNS = (
    "guaranteed", "guaranteed_d_ms", "scenario_d_ms", "guaranteed_command",
    "worst_pattern", "patterns", "disturbances",
)  # fmt: skip
"""Keys of the findings about patterns of delays."""
_FEW_PARTS = 3
_DISTURBED_VALUES = 3
_MOST_VARIANTS = 200
"""Of a follow-up, for each start; their numbers do not depend on what is tried before them."""


class MarginDefinition(CasesDefinition):
    """Settings of a search for margins, as in a study's YAML file.

    Attributes:
        offsets: factors on the scenario's initial offset; a value holds if the bounds are kept from
            every one of these starts, with every seed.
        resolution: resolution of the margin, in the quantity's unit.
        limit: the last value tried, in the quantity's unit; for a number of the scenario it may lie
            below the scenario's own value, where the search begins.
        pattern: ``any``: also test that the margin of a constant delay holds for every pattern of
            delays, or without play-out look for the pattern that is tolerated least.
        disturbances: what else is tried with ``pattern``, at the margin, its half and its quarter:
            messages that are lost, late or overtaken; null for nothing.
        what_helps: at the first failure of each case, also try compensation, automatic play-out, a
            drive loop, half the gains and twice the rate.
        smaller_rotors: where rotors are estimated, search again with a tenth of them.
        model_errors: factors on the scenario's own ``controller.model_scale``; up to the margin, it
            is searched again with each of them.
        thorough: false tries a handful of patterns, and fewer values with `smaller_rotors` and
            `model_errors`.
    """

    seeds: Seeds = Field(default=[1, 2])
    offsets: Different[Number] = Field(default=[1.0, -0.5])
    resolution: Positive | None = None
    limit: Number | None = None
    pattern: Literal["any"] | None = None
    disturbances: DisturbanceSizes | None = Field(default_factory=DisturbanceSizes)
    what_helps: bool = False
    smaller_rotors: bool = False
    model_errors: list[Positive] = Field(default_factory=list)
    thorough: bool = True


class Margin(StudyOfCases):
    """The runs of a search for margins.

    Attributes:
        searches: the search of each case.
        follow_ups: what is tried of each case once its search is over, by its index and name.
        theories: what theory says about the delay of each case, by its index.
    """

    kind = "margin"
    definition_type = MarginDefinition
    definition: MarginDefinition
    named_furthest = "the last value tried (--limit)"

    def __init__(self, values: Mapping[str, Any], source: Path) -> None:
        super().__init__(values, source)
        for setting in (case.setting for case in self.cases):
            if setting.quantity.is_of_link:
                require_hold(setting.base)
        self.columns = {**CASE_COLUMNS, "offset_scale": "double", COLUMN: "string"}
        self.searches = [
            MarginSearch(self._steps(case.setting), variants=case.variants) for case in self.cases
        ]
        self.follow_ups: dict[int, dict[str, MarginSearch]] = {}
        self.theories: dict[int, dict[str, Any]] = {}
        self._recalled: dict[int, dict[str, Any]] = {}
        if self.definition.pattern is not None:
            self.columns["pattern"] = "string"
            for setting, start in ((case.setting, case.variants[0]) for case in self.cases):
                self._checked(setting, shaped(start, HANDFUL[0], setting.quantity))

    @property
    def own_keys(self) -> dict[str, str]:
        own = {UNCERTAINTY: "beside plants (--plants)"}
        if self.definition.pattern is not None:
            keys = (f"link.{name}.pattern" for name in ("uplink", "downlink"))
            own |= dict.fromkeys(keys, "without pattern (--pattern)")
        return own

    @property
    def own_test(self) -> dict[str, Any]:
        wanted, steps = self.definition, self.searches[0].steps
        unknown = sorted({name for case in self.cases for name in self._unknowns(case.setting)})
        return {
            **super().own_test,
            "offsets": wanted.offsets,
            "pattern": wanted.pattern,
            "unknowns": unknown or None,  # as in older baselines
            "resolution": steps.resolution,
            "limit": steps.value(steps.limit),
            **({} if wanted.thorough else {"thorough": False}),  # which older baselines lack
        }

    def _steps(self, setting: Setting) -> Steps:
        return setting.quantity.steps(self.definition.resolution, self.definition.limit)

    def last_value(self, setting: Setting) -> float:
        steps = self._steps(setting)
        return steps.value(steps.limit)

    def variants_of(self, setting: Setting) -> list[Variant]:
        own, key = setting.base.scenario.robot.initial_offset_rad, "robot.initial_offset_rad"
        different: dict[str, Variant] = {}
        for number, scale in enumerate(self.definition.offsets):
            start = override(key, (scale * own + 0.0).tolist())  # no -0.0
            columns = {"offset_scale": scale, COLUMN: None}
            different.setdefault(start, Variant(number, (start,), columns))
        starts = list(different.values())
        if self.definition.pattern is None:
            return starts
        if self.definition.quantity != "delay":
            allowed = f"must be left out for {self.definition.quantity}: only a delay has patterns"
            raise ConfigurationError("pattern", self.definition.pattern, allowed)
        return [shaped(start, None, setting.quantity) for start in starts]

    @property
    def expected(self) -> int:
        left = 0
        for search in self.searches:
            is_begun = bool(search.requested.keys() - search.outcomes.keys())
            left += (search.probes_left - is_begun) * len(search.variants)
        begun = sum(trial.expected for trial in self.all_trials)
        return begun + left * self.runs_per_variant

    @property
    def at_most(self) -> int:
        begun = sum(trial.at_most for trial in self.all_trials)
        left = sum(map(self._variants_at_most, range(len(self.cases))))
        is_known = bool(begun) and any(trial.rows for trial in self.all_trials)
        return begun + left * (self.runs_per_variant if is_known else len(self.definition.seeds))

    def _variants_at_most(self, index: int) -> int:
        """Return the largest number of variants that are left to begin of a case."""
        search, starts = self.searches[index], len(self.cases[index].variants)
        if (others := self.follow_ups.get(index)) is not None:
            return search.variants_at_most + sum(each.variants_at_most for each in others.values())
        found = search.variants_at_most + starts * self._trials_at_most[index]
        if search.margin is None and search.first_failure is not None:
            return search.variants_at_most
        last = search.steps.limit if search.first_failure is None else search.first_failure - 1
        limited = replace(search.steps, first=last, limit=last)
        parts = PARTS if self.definition.thorough else _FEW_PARTS
        unknown = MarginSearch(limited, hints=[last], parts=parts).probes_at_most
        found += starts * unknown * len(self._unknowns(self.cases[index].setting))
        if self.definition.pattern is None:
            return found
        tick_ms = 1e-6 * self.cases[index].setting.base.grid.period_ns
        each = patterns_at_most(tick_ms, is_thorough=self.definition.thorough)
        return found + starts * each * MarginSearch(limited, {0: True}, parts=1).probes_at_most

    @cached_property
    def _trials_at_most(self) -> list[int]:
        """Largest number of remedies and disturbances from each start, by case."""
        wanted, found = self.definition, []
        for setting in (case.setting for case in self.cases):
            tried = len(remedies.changes(setting.base)) if wanted.what_helps else 0
            if wanted.pattern is not None and wanted.disturbances is not None:
                tried += _DISTURBED_VALUES * len(disturbances.changes(wanted.disturbances, setting))
            found.append(tried)
        return found

    def first(self) -> Iterable[PlannedRun]:
        return [
            run for index, each in enumerate(self.searches) for run in self._next_probe(index, each)
        ]

    def follow(self, run: PlannedRun, values: Row) -> Iterable[PlannedRun]:
        index, steps, number = map(int, run.point.split("-"))
        searches = (self.searches[index], *self.follow_ups.get(index, {}).values())
        search = next(each for each in searches if any(v.number == number for v in each.variants))
        rows = search.rows.setdefault(steps, [])
        rows.append(values)
        more = super().follow(run, values)
        trial = self.trials[run.point]
        has_failed = isinstance(search, Trials) and len(trial.rows) >= trial.planned
        if trial.known.outcome is None and not has_failed:  # a remedy that fails does not help
            return more  # nothing if it is unknown for good
        search.outcomes[steps] = all(map(tolerated, rows))
        return self._next_probe(index, search)

    def _next_probe(self, index: int, search: MarginSearch) -> list[PlannedRun]:
        is_own = search is self.searches[index]
        if is_own and index not in self.theories:
            self._ask_theory(index, search)
        if (steps := search.next()) is not None:
            new = search.variants[search.requested.get(steps, 0) :]
            search.requested[steps] = len(search.variants)
            test = SequentialTest(1.0, len(new))  # the first loss decides
            earlier = [row for rows in search.rows.values() for row in rows]
            runs = self.runs_at(index, steps, search.steps.value(steps), new)
            is_exhaustive = isinstance(search, (PatternSearch, Trials))
            return self.begin(runs, test, earlier, is_exhaustive=is_exhaustive)
        if not is_own:
            return []
        others = self.follow_ups[index] = dict(self._follow_ups(index, search))
        return [run for each in others.values() for run in self._next_probe(index, each)]

    def _ask_theory(self, index: int, search: MarginSearch) -> None:
        """Compute the theory of a case when a run has shown that its law works, for the search."""
        if self.definition.quantity != "delay" or not search.outcomes:
            return
        theory = self._recalled.get(index) or theory_beside(self.cases[index].setting)
        self.theories[index] = theory
        if "unstable_ms" in theory:
            search.parts, search.hints = 1, first_loss(theory, search.steps)

    def _follow_ups(self, index: int, search: MarginSearch) -> Iterator[tuple[str, MarginSearch]]:
        """Return what is left to try of a case with this search, with numbers of their own."""
        case, wanted, steps = self.cases[index], self.definition, search.steps
        setting, block = case.setting, _MOST_VARIANTS * len(case.variants)
        if wanted.what_helps and search.margin is not None and search.first_failure is not None:
            rows = [row for rows in search.rows.values() for row in rows]
            seeds = len(wanted.seeds) if any(map(uses_seed, rows)) else 1
            most = len(rows) // 2 // seeds  # variants, whose runs are a third of all
            yield "what_helps", remedies.trials_of(case, search, 2 * block, most)
        if (margin := search.margin) is None:
            return
        limited = replace(steps, first=margin, limit=margin)
        for number, (name, change) in enumerate(self._unknowns(setting).items(), 3):
            variants = changed(case, name, change, number * block)
            parts = PARTS if wanted.thorough else _FEW_PARTS
            yield name, MarginSearch(limited, variants=variants, hints=[margin], parts=parts)
        if wanted.pattern is not None:
            at_margin = load_setup(setting.scenario, setting.at(steps.value(margin)))
            # Without delay all patterns hold.
            yield (
                "patterns",
                PatternSearch(
                    limited,
                    {0: True},
                    parts=1,
                    case=case,
                    at_margin=at_margin,
                    is_thorough=wanted.thorough,
                ),
            )
            if wanted.disturbances is not None:
                values = sorted({margin, margin // 2, margin // 4}, reverse=True)
                changes = disturbances.changes(wanted.disturbances, setting)
                yield "disturbances", trials(case, steps, values, changes, block)

    def _unknowns(self, setting: Setting) -> Changes:
        wanted = self.definition
        return unknowns.changes(
            setting, smaller_rotors=wanted.smaller_rotors, model_errors=wanted.model_errors
        )

    def keeps(self, row: Row) -> bool:
        """Whether a row is of what helps, which a gate in the same folder does not ask for."""
        return not self.definition.what_helps and row.get(COLUMN) is not None

    def recall(self, summary: Mapping[str, Any]) -> None:
        """Take over the theory of custom laws, which `report` does not run."""
        found = [case for case in summary.get("cases", ()) if case.get("theory")]
        for index, tags in enumerate(case.setting.tags for case in self.cases):
            same = [case["theory"] for case in found if tags.items() <= case.items()]
            if same and is_custom(tags["law"]):
                self._recalled[index] = same[0]

    def keep_files(self, summary: dict[str, Any], folder: Path) -> None:
        for index, found in enumerate(summary["cases"]):
            if (worst := found.get("worst_pattern")) is not None:
                search, setting = self.follow_ups[index]["patterns"], self.cases[index].setting
                assert isinstance(search, PatternSearch)
                name, overrides = f"worst_pattern-{index:03d}", search.worst_overrides
                worst |= write_worst_traces(setting, overrides, worst, folder, name)

    def case_findings(self, _rows: list[Row]) -> dict[str, Any]:
        steps = self.searches[0].steps
        return {
            "resolution": steps.resolution,
            "limit": steps.value(steps.limit),
            "completed": all(map(self._is_over, range(len(self.cases)))),
            "offsets": self.definition.offsets,
            ONE_START: self._arms_with_one_start,
            "cases": [
                self._findings_of(index, case) for index, case in enumerate(self.cases)
            ],
        }  # fmt: skip

    @property
    def _arms_with_one_start(self) -> list[str]:
        """Arms whose initial offset is zero, so that every factor on it is the same start."""
        scenarios = [base.scenario for base in self.bases]
        is_several = len(self.definition.offsets) > 1
        return [s.name for s in scenarios if is_several and not s.robot.initial_offset_rad.any()]

    def _is_over(self, index: int) -> bool:
        others = self.follow_ups.get(index)
        return others is not None and all(each.next() is None for each in others.values())

    def _findings_of(self, index: int, case: Case) -> dict[str, Any]:
        search = self.searches[index]
        found = {
            **case.findings,
            **search_findings(search, case, self.columns),
            **self._follow_up_findings(index),
            "theory": self.theories.get(index) if search.next() is None else None,
        }
        return {**found, **quoted(found, is_over=self._is_over(index))}

    def _follow_up_findings(self, index: int) -> dict[str, Any]:
        """Return the findings about patterns, disturbances and remedies that were asked for."""
        wanted, setting = self.definition, self.cases[index].setting
        asked = (
            *_OF_PATTERNS * (wanted.pattern is not None), *["what_helps"] * wanted.what_helps
        )  # fmt: skip
        found, searches = dict[str, Any].fromkeys(asked), self.follow_ups.get(index, {})
        for name, search in searches.items():
            if isinstance(search, PatternSearch):
                found |= search.findings(self.searches[index].rows[search.steps.limit])
            elif isinstance(search, Trials) and search.next() is None:
                kind = remedies if name == "what_helps" else disturbances
                found[name] = kind.findings(setting, search)
        return found | unknowns.findings(searches, self._unknowns(setting))
