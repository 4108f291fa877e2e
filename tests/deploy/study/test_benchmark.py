"""`benchmark` as a study: which runs it makes, what it finds, and how rows of another law join."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from controller.laws import TORQUE_LAWS
from deploy.judge.run_rows import read_rows
from deploy.judge.tested_with import require_same_test
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.benchmark.benchmark import Benchmark
from deploy.studies.benchmark.cells import (
    BENCHMARK_ARMS,
    CONSTANT,
    NETWORK,
    PATTERN,
    PLANTS,
    tuned_gains,
)
from deploy.studies.benchmark.command import BenchmarkOptions
from deploy.study.follow_ups.patterns import HANDFUL
from tests.deploy.study.studies import Here, folder_of, made_up
from tests.warm_process import here

DELAYS_MS = [1.0, 8.0, 32.0]
BOUNDS = {"pid_gravity": 8.0, "smc": 0.0}
"""Delay, ms, up to which the made-up runs of each law keep their bounds without prediction."""


def defined(**more):
    values = {
        "scenarios": ["paper_arm"], "laws": ["pid_gravity", "smc"], "delays_ms": DELAYS_MS,
        "predictors": ["none", "smith"], "networks": ["wifi_idle"], "windows": 3, "plants": 4,
        "duration_s": 1.0, **more,
    }  # fmt: skip
    return Benchmark(values, Path("benchmark"))


def result(run):
    """A run that a pattern, prediction or another plant changes in a known way."""
    is_smc = any(t.startswith("controller.law=") and "smc" in t for t in run.overrides)
    law = "smc" if is_smc else "pid_gravity"
    limit_ms = BOUNDS[law]
    if limit_ms and run.columns["predictor"] == "smith":
        limit_ms = 1e9
    if run.columns["condition"] == PATTERN and "sawtooth" in run.columns["pattern"]:
        limit_ms = min(limit_ms, 1.0)
    if run.columns["condition"] == PLANTS and run.columns["plant"] == 2:
        limit_ms = 1.0
    is_lost = (run.columns["round_trip_ms"] or 0.0) > limit_ms
    if run.columns["condition"] == NETWORK:
        is_lost = run.seed == 3
    return made_up(run, violation_fraction=float(is_lost), law=law)


def carried_out(study):
    """The rows of all runs that a study asks for."""
    workers, asked, rows = Here(result), list(study.first()), []
    while asked:
        run = asked.pop(0)
        workers.submit(run)
        row = workers.finished(0)[1]
        rows.append(row)
        asked += study.follow(run, row)
    return rows


@pytest.fixture(scope="module")
def finished():
    study = defined()
    rows = carried_out(study)
    return study, rows, study.findings(rows)


def cell_of(found, law, predictor):
    (cell,) = [c for c in found["cells"] if (c["law"], c["predictor"]) == (law, predictor)]
    return cell


def test_margins_are_the_last_delays_before_the_first_loss(finished):
    _, _, found = finished
    alone, predicted = (cell_of(found, "pid_gravity", each) for each in ("none", "smith"))
    assert (alone["margin_ms"], alone["any_pattern_ms"]) == (8.0, 1.0)  # the sawtooth's
    assert (predicted["margin_ms"], predicted["any_pattern_ms"]) == (32.0, 32.0)
    assert alone["rms_rad"] == [1e-3, 2e-3, 1e-3]
    assert [each["kept"] for each in alone["plants_kept"]] == [4, 3, 0]
    assert alone["networks"]["wifi_idle"]["kept"] == 2  # of the windows 1, 2 and 3


def test_a_law_that_is_lost_at_the_smallest_delay_has_one_run(finished):
    _, rows, found = finished
    lost = [row for row in rows if row["law"] == "smc"]
    assert [row["condition"] for row in lost] == [CONSTANT, CONSTANT]  # one for each predictor
    assert cell_of(found, "smc", "smith")["margin_ms"] == 0.0


def test_number_of_runs_is_known_at_the_end(finished):
    study, rows, found = finished
    assert found["completed"]
    assert len(rows) == study.expected
    # Alone: delays 1, 8 and the loss at 32; the sawtooth of the patterns is lost at 8 already;
    # windows; plants, of which one is lost at 8. Predicted: every delay, no patterns.
    patterns = 3 * (len(HANDFUL) - 1) + 2
    assert len(rows) == (3 + patterns + 3 + 3 * 3 + 2) + (3 + 3 + 3 * 3 + 2) + 2


def test_delays_belong_to_the_test_of_a_gate():
    tests = [defined(delays_ms=each).tested_with for each in (DELAYS_MS, [1.0, 16.0])]
    (found,) = require_same_test(*tests, allows_changes=True)
    assert found == "delays_ms = [1.0, 8.0, 32.0] before, [1.0, 16.0] now"


def test_windows_and_seeds_share_no_seed_of_a_run():
    study = defined(seeds=[1, 2], laws=["pid_gravity"], predictors=["none"], plants=None)
    (first, _) = study.first()
    runs = list(study.follow(first, made_up(first, law="pid_gravity")))
    other = [r for r in study.first() if r.seed == 2]
    runs += study.follow(other[0], made_up(other[0], law="pid_gravity"))
    seeds = [run.seed for run in runs if run.columns["condition"] == NETWORK]
    # Each seed follows once: windows 0 to 2 of seed 1 are 1, 3 and 5, of seed 2 they are 2, 4, 6.
    assert sorted(seeds) == [1, 2, 3, 4, 5, 6]


def test_only_cells_without_prediction_have_patterns(finished):
    _, rows, _ = finished
    assert {row["predictor"] for row in rows if row["condition"] == PATTERN} == {"none"}


def test_tuned_gains_are_cells_of_their_own():
    gains = {"paper_arm": {"smc": {"slope": 8.0, "switching": 30.0, "linear": 5.0}}}
    study = defined(gains=gains)
    cells = [(cell.law, cell.gains) for cell in study.cells if cell.predictor == "none"]
    assert cells == [("pid_gravity", "given"), ("smc", "given"), ("smc", "tuned")]
    texts = next(r.overrides for r in study.first() if r.columns["gains"] == "tuned")
    assert any(text.startswith("controller.gains.smc=") and "30" in text for text in texts)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"predictors": ["smyth"]}, "predictors = smyth: must be one of none, adaptive"),
        ({"laws": ["nosuch"]}, "one of fixed_time_neural"),
        ({"set": {"controller.law": "pid"}}, "as laws"),
        ({"delays_ms": [8, 1]}, r"^benchmark: delays_ms = .*: must rise"),
        ({"windows": 0}, r"^benchmark: windows = 0"),
        ({"scenarios": ["paper_arm", "openarm"]}, "^openarm: .* must be without delays"),
    ],
)
def test_what_cannot_be_run_is_refused(values, reason):
    with pytest.raises(ScenarioError, match=reason):
        defined(**values)


def test_default_arms_can_be_run_with_delays_and_on_networks():
    study = defined(scenarios=list(BENCHMARK_ARMS), laws=["smc"], predictors=["none"], plants=None)
    assert {cell.scenario for cell in study.cells} == set(BENCHMARK_ARMS)


def test_all_stands_for_the_shipped_laws():
    options = BenchmarkOptions(laws="all,mine:Law", quick=True)
    assert options.definition()["laws"] == [*TORQUE_LAWS, "mine:Law"]


def test_an_unfinished_or_foreign_folder_has_no_tuned_gains(tmp_path):
    with pytest.raises(ScenarioError, match=r"--tuned .*summary\.json: must be the result of tune"):
        tuned_gains([tmp_path])
    unfinished = {"kind": "tune", "completed": False, "scenario": "paper_arm", "laws": {}}
    (tmp_path / "summary.json").write_text(json.dumps(unfinished))
    with pytest.raises(ScenarioError, match="must be a finished result of tune"):
        tuned_gains([tmp_path])


def test_rows_stay_with_their_law_when_cells_are_added_or_missing(tmp_path):
    """Cells of the second arm get other numbers by a further law."""
    more = {"scenarios": ["paper_arm", "iiwa"], "plants": None, "networks": []}
    earlier = defined(**more)
    folder, rows = folder_of(earlier, tmp_path), carried_out(earlier)
    lost, alone = [row for row in rows if row["law"] == "smc"], tmp_path / "alone"
    for run in earlier.first():
        folder.add(run, next(row for row in rows if row["point"] == run.point))
    folder.write()
    grown = defined(**more, laws=["pid_gravity", "tsmc", "smc"])
    again = folder_of(grown, tmp_path)
    found = {grown.cells[int(run.point[:4])].law: again.find(run) for run in grown.first()}
    assert {law: row and row["law"] for law, row in found.items()} == {
        "pid_gravity": "pid_gravity", "tsmc": None, "smc": "smc",
    }  # fmt: skip
    interrupted = folder_of(earlier, alone)
    for run in earlier.first():
        if (row := next((each for each in lost if each["point"] == run.point), None)) is not None:
            interrupted.add(run, row)
    interrupted.write()
    assert folder_of(earlier, alone).find(earlier.first()[0]) is None


SHORT = (
    "paper_arm", "--delays", "1,4", "--networks", "none", "--duration", "0.4", "--predictors",
    "none,smith", "--workers", "1",
)  # fmt: skip


def test_another_law_joins_rows_that_stay_and_other_gains_are_refused(tmp_path):
    out, file = tmp_path / "out", tmp_path / "tuned" / "summary.json"
    file.parent.mkdir()

    def run(laws, damping):
        found = {"gains": {"found": {"stiffness": [900.0] * 3, "damping": [damping] * 3}}}
        laws_found = {"joint_impedance": found}
        tune = {"kind": "tune", "completed": True, "scenario": "paper_arm", "laws": laws_found}
        file.write_text(json.dumps(tune))
        words = (*SHORT, "--laws", laws, "--tuned", file.parent, "--out", out)
        return here("benchmark", *words)

    code, output = run("joint_impedance", 90.0)
    assert code == 0, output
    before = {row["point"]: row["digest"] for row in read_rows(out / "benchmark.parquet")}
    code, output = run("joint_impedance,pid_gravity", 90.0)
    assert code == 0, output
    rows = read_rows(out / "benchmark.parquet")
    assert before.items() <= {row["point"]: row["digest"] for row in rows}.items()
    assert {row["law"] for row in rows} == {"joint_impedance", "pid_gravity"}
    cells = list(csv.DictReader((out / "cells.csv").open(encoding="utf-8")))
    assert {(c["law"], c["gains"]) for c in cells} == {
        ("joint_impedance", "given"), ("joint_impedance", "tuned"), ("pid_gravity", "given"),
    }  # fmt: skip
    assert all(float(cell["margin_ms"]) >= 1.0 for cell in cells)
    code, output = run("joint_impedance,pid_gravity", 95.0)
    assert code == 2
    assert "gains of joint_impedance on paper_arm" in output
