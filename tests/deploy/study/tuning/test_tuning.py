"""`tune` as a study: it goes on, grows, judges elsewhere, and writes scenarios."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

from deploy.judge.run_rows import read_rows
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.tune.result import TuneResult
from deploy.studies.tune.runs import TuneDefinition, judged
from deploy.studies.tune.tables import tune_headline, tune_tables
from deploy.studies.tune.tuning import Tuning, _is_kept
from tests.warm_process import output_of

pytest.importorskip("cma", reason="the extra tuning is not installed")
SHORT = ("--duration", "0.3", "--set", "duration_s=0.4", "--plants", "1", "--workers", "1")


def tuned(out: Path, *words: object, code: int = 0) -> str:
    return output_of("tune", "paper_arm", *SHORT, "--out", out, *words, code=code)


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """Two laws with a budget of 4, then of 8; the rows of both."""
    out = tmp_path_factory.mktemp("tune") / "out"
    found = []
    for budget in (4, 8):
        output = tuned(out, "--laws", "smc,pid_gravity", "--budget", budget)
        found.append({row["point"]: row for row in read_rows(out / "tune.parquet")})
    return out, found, output


def test_a_larger_budget_goes_on_with_the_candidates_of_before(grown):
    _, (small, large), _ = grown
    searched = [point for point, row in small.items() if row["stage"] == "search"]
    assert len(searched) == 2 * 4
    for point in searched:
        assert large[point]["digest"] == small[point]["digest"]
        assert large[point]["gains"] == small[point]["gains"]
    assert sum(row["stage"] == "search" for row in large.values()) == 2 * 8


def test_laws_are_judged_where_they_were_not_tuned(grown):
    out, (_, large), output = grown
    summary = json.loads((out / "summary.json").read_text())
    assert summary["completed"]
    for law in ("smc", "pid_gravity"):
        found = summary["laws"][law]
        assert found["candidates"] == 8
        assert found["cost_found"] <= found["cost_start"]
        assert found["history"][-1] == found["cost_found"]
        assert [each["place"] for each in found["judged"]["found"]] == [
            "another seed", "another start", "another reference", "other plants",
        ]  # fmt: skip
    seeds = {row["stage"]: row["seed"] for row in large.values()}
    assert seeds == {"search": 1, "judge": 2}
    assert "Not converged: " in output  # 8 candidates are not enough


def test_headline_and_conditions_name_the_start_and_both_durations(grown):
    """The search has runs of 0.3 s, the verdict those of the scenario."""
    summary = json.loads((grown[0] / "summary.json").read_text())
    assert summary["conditions"]["duration"] == "0.3 s in the search, 0.4 s judged"
    law = min(summary["laws"].values(), key=lambda law: law["cost_found"])
    start = law["judged"]["start"]
    kept, runs = (sum(each[key] for each in start) for key in ("kept", "runs"))
    headline = tune_headline(TuneResult.model_validate(summary))
    assert headline.endswith(f"not searched ({kept} of {runs} with those of the start)")


def test_arm_that_starts_on_its_reference_has_no_other_start():
    wanted = TuneDefinition(name="t", scenario="paper_arm", laws=["pid"])
    at_rest = load_setup("paper_arm", ["robot.initial_offset_rad=0"])
    for base, names in ((at_rest, 2), (load_setup("paper_arm"), 3)):
        places = [place.name for place in judged(wanted, base)]
        assert len(set(places)) == names
        assert ("another start" in places) == (names == 3)


def test_its_scenarios_have_the_gains_that_were_found(grown):
    out, (_, large), _ = grown
    summary = json.loads((out / "summary.json").read_text())
    gains = summary["laws"]["smc"]["gains"]["found"]
    setup = load_setup(str(out / "smc.yaml"))
    assert setup.scenario.controller.law == "smc"
    assert setup.scenario.duration_s == 0.4
    assert setup.gains.slope.tolist() == gains["slope"]
    assert json.dumps(gains, sort_keys=True) in {row["gains"] for row in large.values()}


def test_drawn_encoders_take_precedence_and_others_have_20_bits(grown):
    study = Tuning({"scenario": "paper_arm", "laws": ["smc"], "plants": 1}, Path("tune"))
    setups = {
        run.columns["place"]: load_setup(run.scenario, run.overrides).scenario.plant.encoder
        for run in study._verdict(0, 0)
    }
    usual = setups["another seed"].resolution_rad
    assert usual == pytest.approx(2.0 * math.pi / 2**20)
    assert setups["other plants"].resolution_rad != usual


def test_gains_for_the_file_of_an_arm_are_a_scenario_too(tmp_path):
    (tmp_path / "arm.urdf").write_text(load_setup("paper_arm").robot.text)
    output_of("tune", tmp_path / "arm.urdf", "--laws", "smc", "--budget", "2", *SHORT,
                        "--out", tmp_path / "out")  # fmt: skip
    setup = load_setup(str(tmp_path / "out" / "smc.yaml"))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert setup.gains.slope.tolist() == summary["laws"]["smc"]["gains"]["found"]["slope"]


def test_its_report_can_be_made_again(grown):
    out, _, _ = grown
    before = json.loads((out / "summary.json").read_text())
    output_of("report", out)
    assert json.loads((out / "summary.json").read_text())["laws"] == before["laws"]


def test_for_margin_every_candidate_runs_at_every_delay(tmp_path):
    words = ("--for", "margin", "--laws", "smc", "--budget", "2", "--delays", "2,300")
    tuned(tmp_path / "out", *words)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    # Nothing survives 300 ms for long, and 2 ms are no trouble.
    assert -1.5 <= summary["laws"]["smc"]["cost_found"] <= -1.0
    judged = summary["laws"]["smc"]["judged"]["start"]
    assert {each["kept_up_to_ms"] for each in judged} <= {2.0, 300.0}


LAW = """
import numpy as np
from controller.control_law import Diagnostics

class Spring:
    def __init__(self, model, stiffness: float = 4000.0, damping: float = 400.0, name="x"):
        self.gains = stiffness, damping
        self.diagnostics = Diagnostics(model.joints)
    def reset(self): pass
    def torque(self, tracking):
        return -self.gains[0] * tracking.error - self.gains[1] * tracking.error_rate
"""


def test_a_law_of_the_user_starts_at_its_defaults_or_within_ranges(tmp_path, monkeypatch):
    (tmp_path / "spring_of_mine.py").write_text(LAW)
    monkeypatch.chdir(tmp_path)
    law = "spring_of_mine:Spring"
    study = Tuning({"scenario": "paper_arm", "laws": [law], "ranges": {"damping": [10, 40]}},
                   Path("tune"))  # fmt: skip
    (first,) = study.first()
    assert json.loads(first.columns["gains"]) == {"stiffness": 4000.0, "damping": 20.0}
    gains = next(text for text in first.overrides if text.startswith("controller.gains."))
    assert gains.startswith("controller.gains.custom=")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"ranges": {"slope": [5, 1]}}, r"ranges.slope = \[5.0, 1.0\]: must rise"),
        ({"ranges": {"slop": [1, 5]}}, "ranges = 'slop': no law has such a gain"),
        (
            {"laws": ["external"], "set": {"controller.external.command": [sys.executable]}},
            "laws = 'external': has no gains here",
        ),
        ({"set": {"controller.law": "pid"}}, "must be given as laws"),
        ({"set": {"link.uplink.delay_ms": 30}}, "must be given as delays"),
    ],
)
def test_unusable_definitions_are_refused(changed, message):
    with pytest.raises(ScenarioError, match=message):
        Tuning({"scenario": "paper_arm", "laws": ["smc"], **changed}, Path("tune"))


@pytest.mark.parametrize("option", ["--at-least=5%", "--confirm"])
def test_options_of_other_studies_are_refused(tmp_path, option):
    output = tuned(tmp_path / "out", option, code=2)
    assert f"No such option: {option.partition('=')[0]}" in output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["benchmark", "datasheet"])
def test_studies_that_confirm_nothing_have_no_option_for_it(command):
    assert "No such option: --confirm" in output_of(command, "--confirm", code=2)


def test_costs_that_earlier_versions_left_empty_are_read(grown):
    """They were infinite, of laws whose torque never changes."""
    summary = json.loads((grown[0] / "summary.json").read_text())
    name, law = next(iter(summary["laws"].items()))
    empty = {"cost_start": None, "cost_found": None, "history": [None], "spread": None}
    summary["laws"] = {name: law | empty | {"gained_in_last_quarter": None}}
    result = TuneResult.model_validate(summary)
    assert tune_headline(result).startswith(f"Lowest cost: – by {name}")
    assert len(tune_tables(result)) >= 1


def test_runs_that_left_nothing_are_not_kept():
    assert not _is_kept({"bounds_kept": None, "error": "ended by signal 9"})
    assert _is_kept({"bounds_kept": True, "error": None}) is True
