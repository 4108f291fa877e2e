"""A run in lockstep is deterministic, and equals simulation and replay."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from running import PATIENT, Finished, funnel_hil_here, settings

from deploy.cli import main
from deploy.judge.run_data import RunData
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.warm_process import cold

DURATION_S, TICKS = 1.0, 1000
SHORT = settings(duration_s=DURATION_S, metrics__from_s=0.5)
LOCKSTEP = [*SHORT, *settings(clock="lockstep")]
DELAYS = settings(link__uplink__delay_ms=2, link__downlink__delay_ms=3)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The command as a user starts it: from nothing, and with its report."""
    out = tmp_path_factory.mktemp("lockstep") / "run"
    ended = cold("run", "paper_arm", *PATIENT, *LOCKSTEP, "--out", out)
    return Finished(out, ended.returncode, ended.stdout + ended.stderr)


@pytest.fixture(scope="module")
def delayed_run(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    out = tmp_path_factory.mktemp("lockstep") / "delayed"
    return funnel_hil_here("run", "paper_arm", *LOCKSTEP, *DELAYS, out=out)


def test_run_finishes_and_is_complete(run: Finished) -> None:
    assert run.code == 0, run.output
    assert run.summary["completed"]
    assert run.summary["faults"] == []
    assert run.summary["ticks"] == TICKS
    assert run.summary["duration_s"] == pytest.approx(DURATION_S)
    assert "real-time factor" in run.output
    per_tick = ("joint_states", "joint_commands", "plant_status", "control_status")
    assert {len(run.data.tables[topic]) for topic in per_tick} == {TICKS}
    assert len(run.data.tables["plant_truth"]) == TICKS + 1  # also what is true after the last tick
    assert run.summary["recorder"]["lost"] == 0


def test_replay_finds_a_torque_that_another_law_would_not_give(tmp_path, monkeypatch, capsys):
    done = simulate(load_setup("paper_arm", ["duration_s=0.2"]))
    stiffer = "controller.gains.fixed_time_neural.k_1=[150, 310, 40]"
    forged = replace(done, setup=load_setup("paper_arm", ["duration_s=0.2", stiffer]))
    forged.write_log(tmp_path / "run.mcap")
    monkeypatch.setattr("sys.argv", ["funnel-hil", "replay", str(tmp_path / "run.mcap")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "different from command" in " ".join(capsys.readouterr().out.split())


def test_constant_delays_are_exact_to_the_microsecond(delayed_run: Finished) -> None:
    timing = delayed_run.summary["timing"]
    assert set(timing["state_age_us"].values()) == {2000.0}
    assert set(timing["round_trip_us"].values()) == {5000.0}
    assert timing["command_age_us"]["max"] == 5000.0  # it takes effect at a tick, and before it
    assert (timing["deadline_misses"], timing["success_rate"]) == (0, 1.0)
    assert delayed_run.digest == simulated(delayed_run.folder).digest


IMPAIRED = {
    "seed": 5, "link__playout_ms": 6, "plant__encoder__velocity_noise_rad_s": 0.001,
    "link__uplink": {"delay_ms": 2, "jitter_ms": 2, "distribution": "pareto", "reorder": True,
                     "duplicate": 0.1, "burst_loss": {"p": 0.05, "r": 0.4}},
    "link__downlink": {"delay_ms": 1, "jitter_ms": 2, "distribution": "normal", "reorder": True,
                       "correlation": 0.5, "duplicate": 0.1, "loss": 0.05},
}  # fmt: skip
LOOPED = {
    "controller__drive_feedback__enabled": True, "controller__delay_compensation__enabled": True,
    "link__uplink": {"delay_ms": 5, "loss": 0.1},
    "plant__drive_feedback__encoder__velocity_noise_rad_s": 0.001,
}  # fmt: skip
LOADED = {
    "plant__physics__engine": "mujoco", "duration_s": 0.4,
    "faults": [{"kind": "payload_picked_up", "payload_kg": 1, "at_s": 0.2}],
}  # fmt: skip


def is_impaired(run: Finished) -> bool:
    counts = [run.summary["transport"][way] for way in ("uplink", "downlink")]
    return all(each[name] for each in counts for name in ("lost", "duplicated", "reordered"))


def has_targets(run: Finished) -> bool:
    commands = run.data.tables["joint_commands"]
    return bool(commands["position"].shape == commands["effort"].shape)


def is_on_mujoco(run: Finished) -> bool:
    integrator = run.data.setup.scenario.plant.physics.integrator
    return f"physics: MuJoCo {version('mujoco')}, {integrator}" in run.output


@pytest.mark.parametrize(
    ("arm", "values", "is_as_meant"),
    [
        ("paper_arm", IMPAIRED, is_impaired),
        ("paper_arm", LOOPED, has_targets),
        ("iiwa", LOADED | {"plant__physics__integrator": "runge_kutta_4"}, is_on_mujoco),
    ],
    ids=["impaired", "drive loop", "MuJoCo Runge-Kutta"],
)
def test_run_equals_simulation_and_replay_bit_for_bit(tmp_path, arm, values, is_as_meant):
    given = settings(**{"duration_s": 0.6, "clock": "lockstep", **values})
    run = funnel_hil_here("run", arm, *given, out=tmp_path / "run")
    assert is_as_meant(run)
    assert run.digest == simulated(run.folder).digest
    assert replay(run.data.setup, run.log).is_identical


def test_summary_has_the_documented_keys(run: Finished) -> None:
    summary = run.summary
    percentiles = {"p50", "p99", "p99_9", "max"}
    assert set(summary) == {
        "scenario", "law", "clock", "link", "duration_s", "ticks", "completed", "faults",
        "real_time_factor", "bounds", "tracking", "torque", "timing", "transport", "recorder",
        "limits", "identified", "digest", "motion", "recording", "commander", "verdict",
        "seed_used", "growing", "loss", "tested_with", "vibrating", "beyond_ranges",
        "not_tested_below_hz", "not_tested_slower_s", "tip_error_mm", "lag_ms",
        "reflexes", "chunks", "robot_lag",
    }  # fmt: skip
    assert set(summary["bounds"]) == {
        "kept", "violation_fraction", "first_violation_s", "margin_min", "margin_min_joint",
        "margin_min_s", "margin_start", "margin_steady",
    }  # fmt: skip
    assert set(summary["tracking"]) == {
        "joint_names", "rms_rad", "max_abs_rad", "settling_time_s", "settling_bound_s"
    }  # fmt: skip
    assert set(summary["torque"]) == {
        "total_variation_nm_per_s", "rms_nm", "peak_nm", "saturated_fraction", "share_above_50_hz",
    }  # fmt: skip
    assert set(summary["timing"]) == {
        "round_trip_us", "command_age_us", "state_age_us", "control_step_us",
        "late_ticks", "late_longest_run", "on_time_rate",
        "wakeup_lateness_us", "deadline_misses", "deadline_miss_longest_run", "success_rate",
        "stolen_ms", "longest_stall_ms",
    }  # fmt: skip
    assert all(set(value) == percentiles for value in summary["timing"].values()
               if isinstance(value, dict))  # fmt: skip
    assert set(summary["transport"]) == {"uplink", "downlink"}
    assert set(summary["transport"]["uplink"]) == {
        "sent", "delivered", "lost", "duplicated", "reordered", "rejected", "delay_ms",
        "loss_burst", "measured_ms",
    }  # fmt: skip
    assert set(summary["transport"]["uplink"]["delay_ms"]) == percentiles | {"mean"}
    assert set(summary["transport"]["uplink"]["loss_burst"]) == {"mean", "longest"}
    assert (summary["scenario"], summary["law"]) == ("paper_arm", "fixed_time_neural")
    assert (summary["clock"], summary["link"]) == ("lockstep", "zenoh")


def simulated(folder: Path, *overrides: str) -> RunData:
    """The scenario of a run, simulated."""
    return simulate(load_setup(str(folder / "scenario.yaml"), overrides)).data()
