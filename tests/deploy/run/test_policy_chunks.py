"""Runs with policies that answer in chunks of 16 actions, 40 ms apart."""

from __future__ import annotations

import math

import pytest

from bus_schema.recording.mcap_log import read_log
from controller.chunks.configuration import CHUNK_MERGES
from deploy.judge.metrics import summarise
from deploy.run.execute import InProcesses, execute, lockstep_setup
from deploy.run.replay import replay
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.one_joint import policy_setup

CHUNKS = "controller.chunks={{horizon: 16, period_ms: 40, {}}}"


def policy(folder, chunks, inference_ms, *more):
    return policy_setup(
        folder, CHUNKS.format(chunks), "controller.between_answers=linear",
        f"controller.inference_ms={inference_ms}", "duration_s=10", *more,
        rows=16, spacing_s=0.04, knows_velocity=True, funnel_rad=0.03,
    )  # fmt: skip


def summary(*args):
    return summarise(simulate(policy(*args)).data())


@pytest.mark.parametrize(
    ("inference_ms", "starved", "verdict"),
    [(320, False, "kept"), (335, True, "kept"), (340, True, "lost")],
)
def test_perfect_chunks_last_twice_their_inference_time(tmp_path, inference_ms, starved, verdict):
    """640 ms of actions: one question at a time is open, so an answer acts until two times later.

    Asked every 40 ms, a question waits up to 25 ms more at 335 ms: 55 ms at rest are 27.5 mrad.
    """
    gains = "controller.gains.custom={rows: 640, spacing_s: 0.001, knows_velocity: true}"
    found = summary(
        tmp_path, "merge: replace, ask_when: 1.0", inference_ms, "controller.every=40",
        "controller.between_answers=hold", "controller.chunks.period_ms=1",
        "controller.chunks.horizon=640", gains,
    )  # fmt: skip
    assert (found["verdict"], found["chunks"]["starved_ticks"] > 0) == (verdict, starved)
    if verdict == "lost":
        assert found["loss"]["reason"] == "chunk ran out"


def test_count_alignment_jumps_by_speed_times_delay(tmp_path):
    """Where the first late chunk takes over; later ones are as late as those before them."""
    by_time = summary(tmp_path, "merge: replace, ask_every: 8", 100)["chunks"]
    by_count = summary(tmp_path, "merge: replace, ask_every: 8, align: count", 100)["chunks"]
    assert by_time["jump_rad"] < 1e-3  # a linear target between two actions
    late_s, at_s = 0.1, by_count["jump_s"]
    expected_rad = 0.5 * abs(math.cos(at_s) - math.cos(at_s - late_s))
    assert by_count["jump_rad"] == pytest.approx(expected_rad, rel=0.02)
    assert by_time["age_ms"]["largest"] == pytest.approx(100 + 8 * 40, abs=1)
    assert by_count["jump_joint"] == "j0"


def test_jerk_of_smooth_targets_is_that_of_their_motion(tmp_path):
    """The third derivative of −0.5 cos t is −0.5 sin t: RMS 0.5/√2 over a whole period."""
    gains = "controller.gains.custom={rows: 64, spacing_s: 0.001, knows_velocity: true}"
    found = summary(
        tmp_path, "merge: replace", 10, "controller.chunks.period_ms=1",
        "controller.chunks.horizon=64", f"duration_s={2 * math.pi:.3f}", gains,
    )["chunks"]  # fmt: skip
    assert found["jerk_rad_s3"] == pytest.approx(0.5, rel=1e-3)
    assert found["jerk_rms_rad_s3"] == pytest.approx(0.5 / math.sqrt(2.0), rel=1e-3)
    assert found["jerk_joint"] == "j0"


def test_jerk_of_a_jump_is_twice_its_size_per_cube_of_an_action(tmp_path):
    """Third differences of a step are its size times 1, −2 and 1."""
    found = summary(
        tmp_path, "merge: replace, ask_every: 320, align: count", 100, "duration_s=3",
        "controller.chunks.period_ms=1", "controller.chunks.horizon=640",
        "controller.gains.custom={rows: 640, spacing_s: 0.001, knows_velocity: true}",
    )["chunks"]  # fmt: skip
    assert found["jerk_rad_s3"] == pytest.approx(2.0 * found["jump_rad"] / 0.001**3, rel=0.01)


def test_jump_of_the_tip_is_the_jump_of_the_joint_times_its_lever(tmp_path):
    """A tip 0.3 m from the axis moves by a chord of the jump."""
    setup = policy(tmp_path, "merge: replace, ask_every: 8, align: count", 100)
    arm = (tmp_path / "arm.urdf").read_text()
    tool = (
        '<joint name="tool" type="fixed"><parent link="l1"/><child link="l2"/>'
        '<origin xyz="0.3 0 0"/></joint><link name="l2"/></robot>'
    )
    (tmp_path / "arm.urdf").write_text(arm.replace("</robot>", tool))
    setup = load_setup(str(setup.source), list(setup.overrides))
    found = summarise(simulate(setup).data())["chunks"]
    assert len(found["jumps"]) == found["switches"]
    for jump in found["jumps"]:
        assert jump["jump_mm"] == pytest.approx(600.0 * math.sin(jump["jump_rad"] / 2.0))
    assert found["jump_mm"] == max(jump["jump_mm"] for jump in found["jumps"]) > 5.0


@pytest.mark.parametrize("merge", CHUNK_MERGES.shipped)
@pytest.mark.parametrize("more", ["ask_every: 6", "ask_when: 0.5"])
def test_age_of_observations_is_at_most_delay_and_time_between_questions(tmp_path, merge, more):
    """d + s: 100 + 6 · 40 or 8 · 40 ms; 640 ms and a further wait if the arm waits."""
    if merge == "spline":
        pytest.importorskip("ruckig")
    if merge == "synchronous":
        more, bound_ms = "", 100 + 640 + 100
    else:
        bound_ms = 100 + (6 if more == "ask_every: 6" else 8) * 40
    found = summary(tmp_path, f"merge: {merge}, {more}", 100, "duration_s=3")["chunks"]
    assert found["age_bound_ms"] == pytest.approx(bound_ms)
    assert bound_ms - 41 <= found["age_ms"]["largest"] <= bound_ms


def test_a_jump_is_the_reason_of_a_loss(tmp_path):
    """At rest in the reference's middle, 250 ms at 0.5 rad/s are 125 mrad of a 100 mrad funnel."""
    policy = "merge: replace, ask_every: 9, align: count"
    found = summary(tmp_path, policy, 300)
    assert found["verdict"] == "lost"
    assert found["loss"]["reason"] == "jump"


@pytest.mark.parametrize("in_processes", [False, True])
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("raise", "RuntimeError: out of memory"),
        ("nan", "targets[5, 0, 0] = nan: must be finite"),
        ("shape", "targets have shape (16, 1): must be (2, 1), or (2, 1) for each row"),
        ("never", "TimeoutError: no answer within 3 s"),
    ],
)
def test_bad_answer_ends_in_a_safe_stop_and_is_named(tmp_path, how, words, in_processes):
    setup = policy(
        tmp_path, "merge: replace", 100, "controller.law=tests.one_joint:BadPolicy", "duration_s=3",
        "link.kind=zenoh", "controller.answer_timeout_s=3", "controller.gains.custom="
        f"{{rows: 16, spacing_s: 0.04, knows_velocity: true, how: {how}}}",
    )  # fmt: skip
    if in_processes:
        found = execute(lockstep_setup(setup), InProcesses()).summary
    else:
        found = summarise(simulate(setup).data())
    assert found["verdict"] == "faulted"
    assert any("law tests.one_joint:BadPolicy failed" in each and words in each
               for each in found["faults"])  # fmt: skip
    assert any("safe stop" in each for each in found["faults"])
    assert found["bounds"]["first_violation_s"] > 1.0  # as the reference leaves the resting arm
    assert found["ticks"] > 1000
    assert found["chunks"]["switches"] > 2
    assert not found["recorder"]["lost"]


@pytest.mark.parametrize("merge", CHUNK_MERGES.shipped)
def test_lockstep_simulation_and_replay_have_equal_digests(merge, tmp_path):
    if merge == "spline":
        pytest.importorskip("ruckig")
    asked = "" if merge == "synchronous" else ", ask_every: 3"
    setup = policy(
        tmp_path, f"merge: {merge}{asked}", 30, "controller.chunks.horizon=8",
        "controller.chunks.period_ms=10", "controller.inference_jitter_ms=5", "duration_s=0.3",
        "link.kind=zenoh",
        "controller.gains.custom={rows: 8, spacing_s: 0.01, knows_velocity: true}",
        "controller.chunks.frozen_prefix={}" if merge == "frozen_prefix" else "seed=3",
        "controller.chunks.ask_every=4" if asked else "seed=3",
    )  # fmt: skip
    simulation = simulate(setup)
    simulation.write_log(tmp_path / "run.mcap")
    in_processes = execute(lockstep_setup(setup), InProcesses()).summary
    assert in_processes["digest"] == simulation.data().digest
    assert replay(setup, read_log(tmp_path / "run.mcap")).is_identical


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("controller.chunks={merge: frozen_prefix, horizon: 16, period_ms: 40, ask_every: 8}",
         "d is 10, s is 8 and H is 16"),
        ("controller.chunks={merge: replac}", "did you mean replace?"),
        ("controller.chunks={horizon: 0}", "controller.chunks.horizon = 0"),
        ("controller.answer_timeout_s=5", "controller.answer_timeout_s = 5"),
    ],
)  # fmt: skip
def test_bad_chunks_are_refused(funnel_hil, override, words):
    more = ("--set", "controller.inference_ms=400", "--set", override)
    assert words in funnel_hil.output("simulate", "paper_arm", *more, code=2)
