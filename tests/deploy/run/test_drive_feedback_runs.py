"""What a drive loop is worth, and what it leaves alone, in virtual time."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from bus_schema.messages.topics import JOINT_COMMANDS, PLANT_TRUTH
from bus_schema.recording.mcap_log import read_log
from deploy.judge.metrics import summarise
from deploy.reports.figures.joints import torques
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.own_laws import own_law

ON = "controller.delay_compensation.enabled=true"
DRIVES = "controller.drive_feedback.enabled=true"
CUT_S, BACK_S = 2.0, 2.19


def each_way(delay_ms, extra=""):
    channel = f"{{delay_ms: {delay_ms}{extra}}}"
    return f"link.uplink={channel}", f"link.downlink={channel}"


HARD = {
    # half of the states and half of the commands are lost: every fourth answer comes through
    "loss": each_way(24, ", loss: 0.5"),
    # each way 20 to 28 ms: round trips of 40 to 56 ms
    "jitter": each_way(24, ", jitter_ms: 4, distribution: uniform"),
    # no command for 190 ms, beside the 64 ms that all of them take
    "outage": (
        *each_way(32), "plant.command_timeout_ms=300",
        f"faults=[{{kind: link_cut, direction: downlink, at_s: {CUT_S}, "
        f"for_s: {BACK_S - CUT_S:.3f}}}]",
    ),
}  # fmt: skip


def run(*overrides, duration_s=4):
    settings = [f"duration_s={duration_s}", f"metrics.from_s={0.25 * duration_s}", *overrides]
    return simulate(load_setup("paper_arm", settings))


@cache
def hard_run(name, *overrides):
    data = run(ON, *HARD[name], *overrides).data()
    return data, summarise(data)


@pytest.mark.parametrize("name", HARD)
def test_drive_loop_keeps_the_bounds_and_absorbs_unmodelled_torques(name):
    data, summary = hard_run(name, DRIVES)
    assert summary["bounds"]["kept"], summary["bounds"]
    assert data.faults() == []
    rms = np.array(summary["tracking"]["rms_rad"])
    without = np.array(hard_run(name)[1]["tracking"]["rms_rad"])
    # Shoulder and elbow, which carry weights: 4 to 14 times as exact with drives of 100 rad/s.
    assert (rms[1:] < 0.35 * without[1:]).all(), (rms, without)


def test_commands_carry_targets_that_lead_the_arm():
    """As of the state's own stamp, so that a line through it meets the state one horizon later."""
    data, _ = hard_run("jitter", DRIVES)
    commands = data.tables[JOINT_COMMANDS.name]
    assert commands["position"].shape == commands["velocity"].shape == commands["effort"].shape
    at, horizon_s = 3000, 0.048
    stamps_s = data.times_s(JOINT_COMMANDS)
    truth, times_s = data.tables[PLANT_TRUTH.name], data.times_s(PLANT_TRUTH)
    then = truth["position"][np.argmin(np.abs(times_s - stamps_s[at] - horizon_s))]
    led = commands["position"][at] + horizon_s * commands["velocity"][at]
    np.testing.assert_allclose(led, then, atol=1e-3)


def test_drives_that_are_given_no_target_change_no_bit():
    """Commands are laid out as ever, and the torques of the plant are those of before."""
    plain = run(duration_s=0.3)
    willing = run("plant.drive_feedback.enabled=true", duration_s=0.3)
    assert plain.data().digest == willing.data().digest
    assert "position" not in plain.data().tables[JOINT_COMMANDS.name].dtype.names
    torques = [
        each.data().tables[PLANT_TRUTH.name]["torque"].tobytes() for each in (plain, willing)
    ]
    assert torques[0] == torques[1]


@pytest.mark.parametrize("compensation", [ON, "controller.delay_compensation.enabled=false"])
def test_a_run_with_drives_repeats_and_replays_bit_for_bit(tmp_path, compensation):
    encoder = "plant.drive_feedback.encoder"
    settings = [
        compensation, DRIVES, *each_way(3, ", jitter_ms: 1"),
        f"{encoder}.velocity_noise_rad_s=0.002", f"{encoder}.resolution_rad=2.4e-5",
    ]  # fmt: skip
    simulation = run(*settings, duration_s=0.5)
    assert run(*settings, duration_s=0.5).data().digest == simulation.data().digest
    simulation.write_log(tmp_path / "run.mcap")
    again = replay(simulation.setup, read_log(tmp_path / "run.mcap"))
    assert again.replayed > 450
    assert again.is_identical


def test_torques_of_drives_that_follow_positions_are_in_all_figures(tmp_path, import_folder):
    """A law without torque: the drives alone move the arm, with the torque of inverse dynamics."""
    law = own_law(import_folder, "return 0.0 * tracking.position")
    data = run(f"controller.law={law}", DRIVES, duration_s=2).data()
    assert not data.tables[JOINT_COMMANDS.name]["effort"].any()
    truth = data.tables[PLANT_TRUTH.name]
    arm = pin.buildModelFromXML(data.setup.robot.text)
    period_s = 1e-9 * data.setup.grid.period_ns
    rates = np.gradient(truth["velocity"], period_s, axis=0)
    needed = (
        truth["friction"]
        + truth["disturbance"]
        + [
            pin.rnea(arm, arm.createData(), *row)
            for row in zip(truth["position"], truth["velocity"], rates, strict=True)
        ]
    )
    moving = needed[200:]  # after the start, where torques reach their limits
    torque = summarise(data)["torque"]
    assert (np.array(torque["peak_nm"]) >= 0.98 * np.abs(moving).max(axis=0)).all()
    assert (np.array(torque["rms_nm"]) > 0.9 * np.sqrt((moving**2).mean(axis=0))).all()
    assert (np.array(torque["total_variation_nm_per_s"]) > 0.0).all()
    assert (np.array(torque["share_above_50_hz"]) > 0.0).all()
    assert torque["saturated_fraction"] > 0.0
    figure = torques(data)
    assert max(np.abs(trace.y).max() for trace in figure.data) > 1.0
