"""Robots with a controller of their own, in whole runs: delays, lags, reflexes, clocks, digests."""

import re
import sys

import numpy as np
import pytest

from bus_schema.recording.mcap_log import read_log
from deploy.judge.metrics import RunResult, summarise
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import InProcesses, JudgedRun, execute, lockstep_setup
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.robot_interface import interface_in_force, preview_s, robot_lag_s
from deploy.scenario.scenario import load_setup
from plant_emulator.robot_controller import RobotController
from tests.deploy.study.theory.linear_arms import Arm, constant

H = 1e-3
K_P = 10.0
KIND = "plant.interface.kind={}"
FAST = "plant.interface.rate_hz=1000"
IDEAL = (KIND.format("speedj"), "plant.interface.speedj.ideal=true", FAST)
PROPORTIONAL = (
    "controller.law=proportional_velocity", f"controller.gains.proportional_velocity.k_p={K_P}",
)  # fmt: skip
STREAMING = "controller.law=streaming"
NO_PREVIEW = "controller.preview_ms=0"
SPEED = 0.3


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """One joint with an inertia alone, 20 mrad away from a reference at rest."""
    return Arm([0.5], [1.0], [1.0], [0.0]).write(tmp_path_factory.mktemp("arm"))


def run(file, *overrides):
    return simulate(load_setup(str(file), overrides)).data()


def moving(folder, duration_s=6.0):
    """The reference moves at a constant speed; overrides."""
    times_s = np.arange(0.0, duration_s + 0.5, 0.05)
    lines = (f"{t:.2f},{SPEED * t:.6f}" for t in times_s)
    path = folder / "ramp.csv"
    path.write_text("\n".join(["time_s,j0.position_rad", *lines]))
    return [f"reference={{kind: csv, file: {path}}}", "robot.initial_offset_rad=0"]


def roots(ticks):
    """Of q_(k+1) = q_k + h (v_k + v_(k−1)) / 2 with v_k = −k_p q_(k−n).

    A velocity is reached over a cycle, at constant acceleration.
    """
    polynomial = np.zeros(ticks + 3)
    polynomial[:2] = 1.0, -1.0
    polynomial[ticks + 1 :] += 0.5 * K_P * H
    return np.roots(polynomial)


def growth_per_s(ticks):
    return np.log(np.abs(roots(ticks)).max()) / H


def test_sampled_margin_of_the_velocity_loop_is_that_of_the_continuous_one_within_a_resolution():
    stable = [ticks for ticks in range(100, 200) if growth_per_s(ticks) < 0.0]
    assert stable == list(range(100, stable[-1] + 1))
    assert 1e-3 * stable[-1] == pytest.approx(np.pi / (2.0 * K_P), abs=1.5e-3)


@pytest.mark.parametrize("delay_ms", [145, 158])
def test_velocity_loop_grows_and_decays_as_its_roots(file, delay_ms):
    """π / 20 s = 157.1 ms is between the two delays."""
    more = (*IDEAL, *PROPORTIONAL, *constant(delay_ms), "plant.command_timeout_ms=1000")
    errors = run(file, *more, "duration_s=12").true_errors_rad[2000:, 0]
    peaks = [np.abs(part).max() for part in np.array_split(errors, 10)]
    slope = np.polyfit(np.arange(10.0), np.log(peaks), 1)[0]
    assert slope == pytest.approx(growth_per_s(delay_ms), abs=0.02)
    assert (slope > 0.0) == (delay_ms > 157.1)


@pytest.mark.parametrize("more", [(), ("controller.between_answers=linear",)])
def test_a_slow_law_drives_a_velocity_robot_as_its_sampled_loop(file, more):
    """Every 20 ms the velocity is −k_p q; it is reached over a cycle, and kept."""
    errors = run(file, *IDEAL, *PROPORTIONAL, "controller.every=20", *more, "duration_s=0.6")
    position, before, expected = errors.true_errors_rad[0, 0], 0.0, []
    for tick in range(500):
        expected.append(position)
        now = -K_P * position if tick % 20 == 0 else before
        position, before = position + 0.5 * H * (before + now), now
    np.testing.assert_allclose(errors.true_errors_rad[:500, 0], expected, atol=2e-4)


ROBOTS = {
    "servoj": ("plant.interface.servoj.lookahead_time_s=0.03", "plant.interface.servoj.gain=1200"),
    "rsi": (),
    "egm": (),
    "servo": (),
    "franka_position": tuple(
        f"plant.interface.franka_position.{key}=1e9"
        for key in ("velocity_rad_s", "acceleration_rad_s2", "jerk_rad_s3")
    ),
    "joint_trajectory": ("plant.interface.joint_trajectory.interpolate_from_desired_state=true",),
    "joint_trajectory from the measured state": (),
    "joint_trajectory with lines": ("plant.interface.joint_trajectory.interpolation=linear",),
    "rsi, five cycles a target": ("rate_hz=50", "plant.substeps=80"),
    "servoj asked every 20 ms, answered 15 ms later": (
        "controller.every=20",
        "controller.inference_ms=15",
    ),
    "servoj that goes on along answers": (
        "controller.every=20",
        "controller.inference_ms=15",
        "controller.between_answers=linear",
    ),
}
"""Those that take positions; where an integrator of velocities is depends on when it began."""


@pytest.mark.parametrize("kind", ROBOTS)
def test_an_arm_at_constant_speed_is_behind_by_delay_and_lag(file, kind, tmp_path):
    """v (d + L + age of answers) without preview, within 2 %; at most 2 % of it with."""
    common = (
        *moving(tmp_path),
        STREAMING,
        KIND.format(re.split("[ ,]", kind)[0]),
        *ROBOTS[kind],
        "link.downlink.delay_ms=20",
    )
    behind = []
    for preview in (NO_PREVIEW, "controller.preview_ms=auto"):
        setup = load_setup(str(file), [*common, preview, "duration_s=2"])
        errors = simulate(setup).data().true_errors_rad[:, 0]
        behind.append(-errors[errors.size // 2 :].mean())
    expected = SPEED * preview_s(setup, setup.link)
    assert preview_s(setup, setup.link) >= 20e-3 + robot_lag_s(setup)
    assert behind[0] == pytest.approx(expected, rel=0.02)
    assert abs(behind[1]) < 0.02 * expected


def test_a_preview_counts_the_delays_of_a_trace(file, tmp_path):
    """12 ms each way, and 8 in the robot."""
    trace = tmp_path / "trace.csv"
    trace.write_text("\n".join(["time_s,delay_ms", *(f"{0.1 * k:.1f},12" for k in range(100))]))
    links = (f"link.{way}.trace={{file: {trace}, start_s: 0}}" for way in ("uplink", "downlink"))
    robot = (KIND.format("rsi"), "plant.interface.rsi={dead_time_ms: 8, lag_ms: 0}")
    setup = load_setup(str(file), [STREAMING, *robot, *links])
    assert preview_s(setup, setup.link) == pytest.approx(32e-3)


def test_drives_that_go_on_along_their_targets_need_no_preview(file, tmp_path):
    """q* + v (t − stamp) is where the reference is: nothing is behind, and nothing ahead."""
    drives = (
        "controller.drive_feedback.enabled=true",
        "controller.drive_feedback.bandwidth_rad_s=300",
    )
    more = (*moving(tmp_path), STREAMING, *drives, "link.downlink.delay_ms=20", "duration_s=4")
    assert abs(run(file, *more).true_errors_rad[2000:, 0]).max() < 0.02 * SPEED * 20e-3


def test_an_external_program_sends_its_targets_to_a_robot(file, tmp_path):
    """Its target is 40 mrad from where it asked: the joint goes there."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    command = f"controller.external.command=[{sys.executable}, {program}]"
    more = ("controller.law=external", command, "controller.external.targets=true")
    errors = run(file, *more, KIND.format("servoj"), "robot.initial_offset_rad=0", "duration_s=1")
    assert errors.true_errors_rad[-1, 0] == pytest.approx(0.04, abs=1e-4)


PROGRAM = """
import struct, sys
while question := sys.stdin.buffer.read(8 * 16):
    reference = struct.unpack("16d", question)[10]
    sys.stdout.buffer.write(struct.pack("4d", 0.0, 0.0, reference + 0.04, 0.0))
    sys.stdout.buffer.flush()
"""


def test_gains_of_the_drives_are_those_of_the_plant_where_it_has_them(file):
    soft = "plant.drive_feedback={stiffness_nm_rad: 5, damping_nm_s: 3}"
    push = "plant.disturbance.terms=[{joint: all, kind: constant, torque_nm: 1}]"
    common = (STREAMING, KIND.format("servoj"), push, "robot.initial_offset_rad=0", "duration_s=8")
    assert run(file, *common, soft).true_errors_rad[-1, 0] == pytest.approx(-0.2, abs=2e-3)
    assert abs(run(file, *common).true_errors_rad[-1, 0]) < 1e-3


LOSES = "link.downlink.schedule=[{{kind: outage, at_s: 1.0005, for_s: {}}}]"


def outcome(file, *overrides):
    """Faults and reflexes."""
    summary = summarise(run(file, *overrides))
    return summary["faults"], summary["reflexes"]


@pytest.mark.parametrize("law", ["streaming", "pid"])
def test_franka_survives_19_lost_packets_and_stops_at_20(file, law):
    kind = "franka_torque" if law == "pid" else "franka_position"
    common = (f"controller.law={law}", KIND.format(kind), "robot.initial_offset_rad=0")
    assert outcome(file, *common, LOSES.format(0.019)) == ([], [])
    data = run(file, *common, LOSES.format(0.020))
    summary = summarise(data)
    faults, reflexes = summary["faults"], summary["reflexes"]
    reasons = " ".join(verdict_on_run(JudgedRun("run", data, RunResult(**summary))).reasons)
    assert "s by its reflex communication_constraints_violation." in reasons
    assert [(each["kind"], each["joint"]) for each in reflexes] == [
        ("communication_constraints_violation", None)
    ]
    assert reflexes[0]["time_s"] == pytest.approx(1.02, abs=2e-3)
    assert "20 torques" in faults[0] if law == "pid" else "20 targets" in faults[0]


def test_franka_names_the_joint_whose_torque_steps(file):
    """Stiff PID on 20 mrad, after a loss of 15 packets while it moves."""
    common = ("controller.law=pid", KIND.format("franka_torque"), LOSES.format(0.015))
    steep = "controller.gains.pid={proportional: 3000, derivative: 2, integral: 0}"
    _, reflexes = outcome(file, *common, steep)
    assert [(each["kind"], each["joint"]) for each in reflexes] == [
        ("controller_torque_discontinuity", "j0")
    ]
    assert outcome(file, *common, steep, "plant.interface.franka_torque.limiter=true")[1] == []


def test_clocks_that_differ_by_20_ppm_at_500_hz_slip_one_command_in_100_s(file):
    """Cycles of the robot in 100 s, against as many commands as the loop sends."""

    def cycles(*clocks):
        words = [STREAMING, KIND.format("servo"), "plant.interface.rate_hz=500", *clocks]
        setup = load_setup(str(file), [*words, "plant.interface.phase_ms=1"])
        robot = RobotController(interface_in_force(setup), lambda *_: np.zeros(1), setup.grid)
        robot.start(np.zeros(1), 0)
        end, count = round(100.0 / setup.grid.substep_s), 0
        while robot.next_due < end:
            robot.cycle(np.zeros((2, 1)))
            count += 1
        return count

    assert cycles() == 50_000
    assert cycles("plant.interface.clock_ppm=20.1") == 50_001
    assert cycles("controller.clock_ppm=20.1") == 49_999
    assert cycles("plant.interface.clock_ppm=20.1", "controller.clock_ppm=20.1") == 50_000


KINDS = {
    "servoj": "streaming", "speedj": "proportional_velocity", "franka_position": "streaming",
    "franka_velocity": "proportional_velocity", "franka_torque": "pid", "egm": "streaming",
    "rsi": "position_correction", "joint_trajectory": "streaming", "servo": "streaming",
}  # fmt: skip


def simulated(kind):
    """A setup with clocks that differ and cycles out of phase, and its simulation."""
    words = [
        "duration_s=0.2", f"controller.law={KINDS[kind]}", KIND.format(kind),
        "plant.interface.clock_ppm=300", "plant.interface.phase_ms=0.3",
        "link.uplink.delay_ms=3", "link.downlink={delay_ms: 2, jitter_ms: 1, loss: 0.1}",
    ]  # fmt: skip
    setup = load_setup("paper_arm", words)
    return setup, simulate(setup)


@pytest.mark.parametrize("kind", KINDS)
def test_a_replay_has_the_bits_of_the_simulation(kind, tmp_path):
    setup, simulation = simulated(kind)
    simulation.write_log(tmp_path / "run.mcap")
    assert replay(setup, read_log(tmp_path / "run.mcap")).is_identical


@pytest.mark.parametrize("kind", ["rsi", "franka_velocity", "franka_torque"])
def test_lockstep_has_the_digest_of_the_simulation(kind):
    """A robot that takes positions, one that takes velocities, and one that takes torques."""
    setup, simulation = simulated(kind)
    in_processes = execute(lockstep_setup(setup), InProcesses()).summary
    assert in_processes["digest"] == simulation.data().digest
    assert in_processes["motion"] == simulation.data().motion


def test_lag_is_a_time_per_joint_and_none_at_rest(file, tmp_path):
    common = (STREAMING, NO_PREVIEW, KIND.format("servoj"), *ROBOTS["servoj"], "duration_s=4")
    data = run(file, *common, *moving(tmp_path), "link.downlink.delay_ms=24")
    moves = summarise(data)
    reasons = verdict_on_run(JudgedRun("run", data, RunResult(**moves))).reasons
    [said] = [each for each in reasons if each.startswith("Joints were")]
    assert said.startswith("Joints were behind their reference by 54 ms at most (j0)")
    assert "the robot's own lag is 30 ms" in said
    assert (moves["robot_lag"]["preview_ms"], moves["robot_lag"]["without_preview_ms"]) == (0, None)
    assert not any("The controller read" in each for each in reasons)
    # 30 ms in the robot, of which a cycle is the wait; 24 on the way.
    assert moves["lag_ms"] == [pytest.approx(54.0, abs=1.0)]
    assert moves["reflexes"] == []
    assert summarise(run(file, *common))["lag_ms"] == [None]


def test_a_preview_and_the_lag_without_it_are_named(file, tmp_path):
    """30 ms in the robot and 24 on the way, for which a preview makes up."""
    common = (STREAMING, KIND.format("servoj"), *ROBOTS["servoj"], "duration_s=4")
    data = run(file, *common, *moving(tmp_path), "link.downlink.delay_ms=24")
    moves = RunResult(**summarise(data))
    assert moves.robot_lag.own_ms == pytest.approx(30.0, abs=1.0)
    assert moves.robot_lag.preview_ms == pytest.approx(54.0, abs=1.0)
    assert moves.robot_lag.without_preview_ms == pytest.approx(54.0, abs=1.0)
    reasons = verdict_on_run(JudgedRun("run", data, moves)).reasons
    [said] = [each for each in reasons if each.startswith("The controller read")]
    assert said == (
        "The controller read the reference 54 ms ahead, 30 ms of it for the robot's own lag. With a"
        " source that cannot be read ahead, as in teleoperation, joints would be 54 ms behind"
        " (controller.preview_ms: 0)."
    )
    assert summarise(run(file, "duration_s=0.1"))["robot_lag"] is None  # it takes torques


@pytest.mark.parametrize(("kind", "is_known"), [("servoj", True), ("joint_trajectory", False)])
def test_the_part_of_lost_messages_is_named_or_how_to_find_it(kind, is_known):
    """A third of the states is lost: commands are 1/3 + 1/9 + ... = 0.5 cycles older."""
    words = (STREAMING, NO_PREVIEW, KIND.format(kind), "link.uplink.loss=0.333", "duration_s=5")
    data = run("paper_arm", *words)
    moves = RunResult(**summarise(data))
    lag, tip_mm = moves.robot_lag, moves.tip_error_mm.rms
    assert lag.late_ms == pytest.approx(0.5, abs=0.06)
    assert lag.tip_rms_mm == pytest.approx(tip_mm, rel=0.02)  # of a slow motion it is the lag's
    reasons = " ".join(verdict_on_run(JudgedRun("run", data, moves)).reasons)
    assert re.search(r"messages lost, commands in force were 0\.[45]\d* ms older", reasons)
    assert ("--set link.uplink.loss=0 shows" in reasons) == (not is_known)
    if is_known:
        assert lag.late_tip_rms_mm == pytest.approx(tip_mm * lag.late_ms / moves.lag_ms[0], rel=0.1)
        assert f"about {lag.late_tip_rms_mm:.3g} mm at the tip (RMS)" in reasons
    else:  # its lag is one thing with all points, another one with two thirds of them
        assert lag.late_tip_rms_mm is None
