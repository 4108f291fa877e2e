"""Results on other physics."""

import json
import math

import pytest

from deploy.run.confirmation import (
    CONFIRMATION,
    confirmation_of,
    confirmations,
    other_physics,
    simulated_otherwise,
)
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.physics.engines import ENGINES
from tests.arms import INSTALLED
from tests.one_joint import pd_setup

BOTH = pytest.mark.skipif(len(INSTALLED) < 2, reason="needs pybullet beside MuJoCo")


@BOTH
@pytest.mark.parametrize("scenario", ["paper_arm", "iiwa"])
def test_shipped_arms_agree_to_a_tenth_of_a_microradian(scenario):
    """Without compensation Euler against Euler differ by rounding that the loop keeps small."""
    data = simulate(load_setup(scenario, ["duration_s=1", "metrics.from_s=0.5"])).data()
    euler, runge_kutta = confirmation_of(JudgedRun("", data))
    assert (euler["physics"], euler["agree"]) == ("MuJoCo, semi_implicit_euler", 1)
    assert euler["error_difference_rad"] < 1e-7
    # a rule of another order moves the arm by what the first-order one gets wrong
    assert 1e-7 < runge_kutta["error_difference_rad"] < 1e-2


def test_undamped_gear_keeps_its_bounds_by_every_integrator(tmp_path):
    """It swings at 40 Hz; with a growth of ω² h / 12 it would leave them within 3 s."""
    rotor, link, rad_s = 0.5, 1.0, 2.0 * math.pi * 40.0
    actuator = {
        "rotor_inertia_kg_m2": rotor,
        "gear_stiffness_nm_rad": rad_s**2 / (1 / rotor + 1 / link),
    }
    pulse = {"joint": "j0", "kind": "pulse", "torque_nm": 2, "start_s": 0.1, "duration_s": 0.01}
    plant = {"actuator": actuator, "disturbance": {"terms": [pulse]}}
    # a law that does almost nothing; the bounds are wide enough for the drift
    setup = pd_setup(tmp_path, link, 1e-6, 1e-6, funnel_rad=0.1, plant=plant)
    (other,) = confirmation_of(JudgedRun("", simulate(setup).data()))
    assert other["agree"] == 1
    assert other["error_difference_rad"] < 1e-4


def test_other_physics_are_all_but_the_one_in_force():
    names = list(other_physics(load_setup("paper_arm", ["plant.physics.engine=mujoco"])))
    assert names[-1] == "MuJoCo, runge_kutta_4"
    assert "MuJoCo, semi_implicit_euler" not in names
    assert len(names) == len(INSTALLED)


def row(kept, margin, others):
    on, its_kept, its_margins = zip(*others, strict=True)
    return {
        "scenario": "s", "law": "l", "completed": True, "error": None,
        "verdict": "kept" if kept else "lost", "bounds_kept": kept,
        "margin_min": margin, "confirmed_on": on, "confirmed_kept": its_kept,
        "confirmed_margin_min": its_margins, "confirmed_error_difference_rad": [None] * len(on),
    }  # fmt: skip


def test_verdicts_that_differ_near_zero_are_too_near_to_call():
    rows = [
        row(True, 0.2, [("A", True, 0.1), ("B", False, -0.5)]),
        row(True, 0.02, [("A", False, -0.1), ("B", True, 0.02)]),
        {"scenario": "s", "law": "l", "error": "failed"},
    ]
    a, b = confirmations(rows)
    assert (a["runs"], a["agree"], a["too_near"], a["differ"]) == (2, 1, 1, 0)
    assert (b["runs"], b["agree"], b["too_near"], b["differ"]) == (2, 1, 0, 1)
    assert a["margin_difference"] == pytest.approx(0.12)
    assert b["margin_difference"] == pytest.approx(0.7)


def test_recording_of_an_engine_that_is_not_installed_is_judged(funnel_hil, tmp_path, monkeypatch):
    words = ["simulate", "paper_arm", "--set", "duration_s=0.2", "--out", tmp_path / "run"]
    funnel_hil(*words, "--no-report", "--set", "plant.physics.engine=mujoco")
    scenario = tmp_path / "run/scenario.yaml"
    monkeypatch.setattr(type(ENGINES["mujoco"]), "is_installed", False)
    for command in ("report", "replay"):
        funnel_hil.output(command, tmp_path / "run")
    (tmp_path / "run/manifest.json").write_text('{"scenario": 1}')  # of no run
    funnel_hil.output("report", tmp_path / "run")
    shown = funnel_hil.output("simulate", scenario, "--out", tmp_path / "again", code=2)
    assert "MuJoCo is not installed (pip install mujoco)" in shown


def test_simulate_and_report_keep_the_confirmation(funnel_hil, tmp_path):
    words = ["simulate", "paper_arm", "--set", "duration_s=0.2", "--out", tmp_path / "run"]
    _, shown = funnel_hil(*words, "--confirm")
    assert "Confirmation on other physics" in shown
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert [each["agree"] for each in summary[CONFIRMATION]] == [1] * len(INSTALLED)
    assert "Confirmation on other physics" in (tmp_path / "run/report.html").read_text()
    funnel_hil("report", tmp_path / "run")
    assert json.loads((tmp_path / "run/summary.json").read_text()) == summary


def test_a_run_that_simulates_otherwise_is_an_alarm(tmp_path):
    short = ["duration_s=0.2", "metrics.from_s=0.1"]
    recorded = load_setup("paper_arm", short)
    simulate(recorded).write_log(tmp_path / "run.mcap")
    assert simulated_otherwise(recorded, tmp_path) == []
    changed = load_setup("paper_arm", [*short, "plant.payload_kg=1"])
    (alarm,) = simulated_otherwise(changed, tmp_path)
    assert "differs from the run" in alarm
