"""A run in lockstep is deterministic, and equals simulation and replay."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from running import PATIENT, Finished, bits, funnel_hil_here, settings

from deploy.cli import main
from deploy.runs.replay import replay
from deploy.runs.run_data import RunData
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import SHIPPED, load_setup
from tests.warm_process import HANG_S, ROOT

DURATION_S, TICKS = 1.0, 1000
SHORT = settings(duration_s=DURATION_S, metrics__from_s=0.5)
LOCKSTEP = [*SHORT, *settings(clock="lockstep")]
DELAYS = settings(link__uplink__delay_ms=2, link__downlink__delay_ms=3)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The command as a user starts it: from nothing, and with its report."""
    out = tmp_path_factory.mktemp("lockstep") / "run"
    ended = subprocess.run(
        [sys.executable, "-m", "deploy.cli", "run", "paper_arm", *PATIENT, *LOCKSTEP,
         "--out", str(out)],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "400"}, text=True,
        capture_output=True, timeout=HANG_S, check=False,
    )  # fmt: skip
    return Finished(out, ended.returncode, ended.stdout + ended.stderr)


@pytest.fixture(scope="module")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    out = tmp_path_factory.mktemp("lockstep") / "simulation"
    return funnel_hil_here("simulate", "paper_arm", *SHORT, out=out)


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


def test_run_equals_simulation_bit_for_bit(run: Finished, simulation: Finished) -> None:
    assert simulation.code == 0
    assert run.digest == simulation.digest
    for topic in ("joint_states", "joint_commands", "plant_status", "plant_truth"):
        assert bits(run.log, topic) == bits(simulation.log, topic)


def test_run_equals_itself_a_second_time(run: Finished, tmp_path: Path) -> None:
    again = funnel_hil_here("run", "paper_arm", *LOCKSTEP, out=tmp_path / "again")
    assert again.digest == run.digest


@pytest.mark.parametrize("kind", ["run", "simulation"])
def test_replay_gives_the_same_digest(
    kind: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    recorded: Finished = request.getfixturevalue(kind)
    monkeypatch.setattr("sys.argv", ["funnel-hil", "replay", str(recorded.folder)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().out.split()
    assert ended.value.code == 0
    assert said.count(recorded.digest) == 2  # as recorded, and as replayed
    assert "identical" in said


def test_replay_finds_a_torque_that_another_law_would_not_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = simulate(load_setup("paper_arm", ["duration_s=0.2"]))
    stiffer = "controller.gains.fixed_time_neural.k_1=[150, 310, 40]"
    forged = replace(done, setup=load_setup("paper_arm", ["duration_s=0.2", stiffer]))
    forged.write_log(tmp_path / "run.mcap")
    monkeypatch.setattr("sys.argv", ["funnel-hil", "replay", str(tmp_path / "run.mcap")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "different from command" in " ".join(capsys.readouterr().out.split())


def test_seed_decides_the_noise() -> None:
    noise = ["duration_s=0.1", "plant.encoder.velocity_noise_rad_s=0.001"]
    first, again, other = (
        simulate(load_setup("paper_arm", [*noise, f"seed={seed}"])).data().digest
        for seed in (5, 5, 6)
    )
    assert first == again
    assert first != other


def test_constant_delays_are_exact_to_the_microsecond(delayed_run: Finished) -> None:
    assert delayed_run.code == 0, delayed_run.output
    timing = delayed_run.summary["timing"]
    assert set(timing["state_age_us"].values()) == {2000.0}
    assert set(timing["round_trip_us"].values()) == {5000.0}
    assert timing["command_age_us"]["max"] == 5000.0  # it takes effect at a tick, and before it
    assert (timing["deadline_misses"], timing["success_rate"]) == (0, 1.0)
    assert delayed_run.digest == simulated(delayed_run.folder).digest


def test_delayed_states_and_commands_are_accounted_for(delayed_run: Finished) -> None:
    uplink, downlink = (delayed_run.summary["transport"][way] for way in ("uplink", "downlink"))
    # The state of tick k is delivered at k + 2 < TICKS, its answer in force at k + 5 <= TICKS.
    assert (uplink["sent"], uplink["delivered"]) == (TICKS, TICKS - 2)
    assert (downlink["sent"], downlink["delivered"]) == (TICKS - 2, TICKS - 4)
    for channel in (uplink, downlink):
        assert (channel["lost"], channel["duplicated"], channel["reordered"]) == (0, 0, 0)
        assert channel["rejected"] == {}


def test_impaired_run_equals_simulation_and_replay_bit_for_bit(tmp_path: Path) -> None:
    impaired = settings(
        duration_s=0.6, clock="lockstep", seed=5, link__playout_ms=6,
        plant__encoder__velocity_noise_rad_s=0.001,
        link__uplink={"delay_ms": 2, "jitter_ms": 2, "distribution": "pareto", "reorder": True,
                      "duplicate": 0.1, "burst_loss": {"p": 0.05, "r": 0.4}},
        link__downlink={"delay_ms": 1, "jitter_ms": 2, "distribution": "normal", "reorder": True,
                        "correlation": 0.5, "duplicate": 0.1, "loss": 0.05},
    )  # fmt: skip
    run = funnel_hil_here("run", "paper_arm", *impaired, out=tmp_path / "run")
    assert run.code == 0, run.output
    for way in ("uplink", "downlink"):
        counts = run.summary["transport"][way]
        assert min(counts[name] for name in ("lost", "duplicated", "reordered")) > 0
    assert run.digest == simulated(run.folder).digest
    assert replay(run.data.setup, run.log).is_identical


def test_run_with_a_loop_at_the_drives_equals_simulation_and_replay_bit_for_bit(
    tmp_path: Path,
) -> None:
    looped = settings(
        duration_s=0.6, clock="lockstep", controller__drive_feedback__enabled=True,
        controller__delay_compensation__enabled=True, link__uplink={"delay_ms": 5, "loss": 0.1},
        plant__drive_feedback__encoder__velocity_noise_rad_s=0.001,
    )  # fmt: skip
    run = funnel_hil_here("run", "paper_arm", *looped, out=tmp_path / "run")
    assert run.code == 0, run.output
    commands = run.data.tables["joint_commands"]
    assert commands["position"].shape == commands["effort"].shape
    assert run.digest == simulated(run.folder).digest
    assert replay(run.data.setup, run.log).is_identical


@pytest.mark.parametrize("integrator", ["semi_implicit_euler", "runge_kutta_4"])
def test_run_on_mujoco_equals_simulation_and_replay_bit_for_bit(
    tmp_path: Path, integrator: str
) -> None:
    physics = settings(
        duration_s=0.4, clock="lockstep", plant__physics__engine="mujoco",
        plant__physics__integrator=integrator,
        faults=[{"kind": "payload_picked_up", "payload_kg": 1, "at_s": 0.2}],
    )  # fmt: skip
    run = funnel_hil_here("run", "iiwa", *physics, out=tmp_path / "run")
    assert run.code == 0, run.output
    assert f"physics: MuJoCo {version('mujoco')}, {integrator}" in run.output
    assert run.digest == simulated(run.folder).digest
    assert replay(run.data.setup, run.log).is_identical


def test_recording_is_readable_by_other_peoples_tools(run: Finished) -> None:
    with (run.folder / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        schemas = {schema.encoding for schema in reader.get_summary().schemas.values()}
        channels = reader.get_summary().channels.values()
        assert schemas == {"ros2msg"}
        assert {channel.message_encoding for channel in channels} == {"cdr"}
        counts: dict[str, int] = {}
        for _, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            if channel.topic == "/joint_commands":
                assert list(message.name) == ["base_yaw", "shoulder", "elbow"]
                assert len(message.effort) == 3
    per_tick = {"/joint_states", "/joint_commands", "/plant_status", "/control_status"}
    assert {counts[topic] for topic in per_tick} == {TICKS}
    assert counts["/plant_truth"] == TICKS + 1  # also what is true after the last tick
    assert sum(counts.values()) == run.summary["recorder"]["messages"]
    assert run.summary["recorder"]["lost"] == 0


def test_summary_has_the_documented_keys(run: Finished) -> None:
    summary = run.summary
    percentiles = {"p50", "p99", "p99_9", "max"}
    assert set(summary) == {
        "scenario", "law", "clock", "link", "duration_s", "ticks", "completed", "faults",
        "real_time_factor", "bounds", "tracking", "torque", "timing", "transport", "recorder",
        "limits", "identified", "digest", "recording", "commander", "verdict",
    }  # fmt: skip
    assert set(summary["bounds"]) == {
        "kept", "violation_fraction", "first_violation_s", "margin_min"
    }  # fmt: skip
    assert set(summary["tracking"]) == {
        "joint_names", "rms_rad", "max_abs_rad", "settling_time_s", "settling_bound_s"
    }  # fmt: skip
    assert set(summary["torque"]) == {
        "total_variation_nm_per_s", "rms_nm", "peak_nm", "saturated_fraction", "share_above_50_hz",
    }  # fmt: skip
    assert set(summary["timing"]) == {
        "round_trip_us", "command_age_us", "state_age_us", "control_step_us",
        "wakeup_lateness_us", "deadline_misses", "deadline_miss_longest_run", "success_rate",
        "stolen_ms", "longest_stall_ms",
    }  # fmt: skip
    assert all(set(value) == percentiles for value in summary["timing"].values()
               if isinstance(value, dict))  # fmt: skip
    assert set(summary["transport"]) == {"uplink", "downlink"}
    assert set(summary["transport"]["uplink"]) == {
        "sent", "delivered", "lost", "duplicated", "reordered", "rejected", "delay_ms", "loss_burst"
    }  # fmt: skip
    assert set(summary["transport"]["uplink"]["delay_ms"]) == percentiles | {"mean"}
    assert set(summary["transport"]["uplink"]["loss_burst"]) == {"mean", "longest"}
    assert (summary["scenario"], summary["law"]) == ("paper_arm", "fixed_time_neural")
    assert (summary["clock"], summary["link"]) == ("lockstep", "zenoh")


def test_manifest_tells_gains_and_versions(run: Finished) -> None:
    manifest = json.loads((run.folder / "manifest.json").read_text())
    shipped = yaml.safe_load((SHIPPED / "paper_arm.yaml").read_text())
    k_1 = shipped["controller"]["gains"]["fixed_time_neural"]["k_1"]
    assert manifest["gains"]["fixed_time_neural"]["k_1"] == k_1
    assert manifest["scenario"]["clock"] == "lockstep"
    for library in ("eclipse-zenoh", "pybullet", "numpy", "mcap"):
        assert manifest["versions"][library][0].isdigit()


def test_report_is_one_file_that_fetches_nothing(run: Finished) -> None:
    report = (run.folder / "report.html").read_text()
    assert "paper_arm" in report
    assert 'src="http' not in report
    assert 'rel="stylesheet" href="http' not in report


def test_bounds_that_are_kept_are_no_fault(tmp_path: Path) -> None:
    run = funnel_hil_here("simulate", "paper_arm", *SHORT, "--require-bounds", out=tmp_path / "run")
    assert run.code == 0, run.output
    assert run.summary["bounds"]["kept"]


def test_pid_leaves_the_funnel_and_the_exit_code_says_so(tmp_path: Path) -> None:
    words = ["simulate", "paper_arm", *settings(duration_s=1, controller__law="pid")]
    run = funnel_hil_here(*words, "--require-bounds", out=tmp_path / "a")
    assert run.code == 3
    assert run.summary["completed"]
    assert not run.summary["bounds"]["kept"]
    assert run.summary["bounds"]["violation_fraction"] > 0
    assert run.summary["bounds"]["margin_min"] < 0
    assert "bounds not kept" in run.output
    assert funnel_hil_here(*words, out=tmp_path / "b").code == 0  # nobody asked for bounds


def simulated(folder: Path, *overrides: str) -> RunData:
    """The scenario of a run, simulated."""
    return simulate(load_setup(str(folder / "scenario.yaml"), overrides)).data()
