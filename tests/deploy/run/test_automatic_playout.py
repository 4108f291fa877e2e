"""With automatic play-out, a command acts when it says so: how a delay varies changes no bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.delay_range import configured_delays_ns, round_trip_ns

ON = "controller.delay_compensation.enabled=true"
EXPECTED = "controller.delay_compensation.expected_round_trip_ms"
DRIVES = ("controller.drive_feedback.enabled=true", "plant.drive_feedback.enabled=true")
TICKS = np.arange(600)
PATTERNS = {
    "constant": lambda longest_ms, _: np.full(600, longest_ms),
    "square wave": lambda longest_ms, period: np.where(TICKS // period % 2, longest_ms, 1.0),
    "sawtooth": lambda longest_ms, period: 1.0 + (longest_ms - 1.0) * (TICKS % period) / period,
    "random": lambda longest_ms, period: np.random.default_rng(period).uniform(1, longest_ms, 600),
}


def trace(folder: Path, delays_ms) -> str:
    """Override for an uplink that delays states like this, one value per ms."""
    file = folder / "trace.csv"
    rows = [f"{1e-3 * tick:.3f},{delay:.6f}" for tick, delay in enumerate(delays_ms)]
    file.write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    return f"link.uplink.trace={{file: {file}, start_s: 0}}"


def run(arm, *overrides, duration_s=0.3):
    return simulate(load_setup(arm, [f"duration_s={duration_s}", ON, *overrides]))


def motion(of_run) -> bytes:
    """All positions, velocities and torques of the arm, bit for bit."""
    truth = of_run.data().tables["plant_truth"]
    return b"".join(truth[name].tobytes() for name in ("position", "velocity", "torque"))


def playout(of_run):
    return summarise(of_run.data())["transport"]["playout"]


@settings(
    max_examples=6, deadline=None, suppress_health_check=list(HealthCheck), phases=[Phase.generate]
)
@given(
    st.sampled_from(sorted(PATTERNS)),
    st.integers(1, 300),
    st.sampled_from(["paper_arm", "panda_motors"]),
    st.sampled_from(["fixed_time_neural", "fixed_time_adaptive", "pid"]),
    st.sampled_from([(), DRIVES]),
)
def test_every_pattern_up_to_the_expected_delay_gives_the_same_motion(
    tmp_path_factory, name, period, arm, law, drives
):
    """17 ms are expected, the uplink takes up to 16, and the downlink 1."""
    folder = tmp_path_factory.mktemp("trace")
    common = (f"controller.law={law}", f"{EXPECTED}=17", "link.downlink.delay_ms=1", *drives)
    constant = run(arm, *common, "link.uplink.delay_ms=16")
    varying = run(arm, *common, trace(folder, PATTERNS[name](16.0, period)))
    assert motion(varying) == motion(constant)
    assert playout(varying)["late"] == 0
    assert playout(varying)["horizon_ms"] == dict.fromkeys(("p50", "p99", "p99_9", "max"), 17.0)


def test_a_constant_delay_needs_no_playout_and_gets_none_beyond_itself():
    automatic, plain = (
        run("paper_arm", "link.uplink.delay_ms=16", f"link.playout_ms={value}")
        for value in ("auto", "0")
    )
    assert motion(automatic) == motion(plain)
    assert playout(automatic)["least_slack_ms"] == 0.0


def test_the_default_keeps_the_bounds_where_acting_on_arrival_loses_them(tmp_path):
    wave = trace(tmp_path, PATTERNS["square wave"](47.0, 30))
    kept = [
        summarise(run("paper_arm", wave, *more, duration_s=1.5).data())["bounds"]["kept"]
        for more in ((), ("link.playout_ms=0",))
    ]
    assert kept == [True, False]


def test_late_commands_make_the_horizon_grow_at_once(tmp_path):
    """2 ms for 0.2 s, then 12: 3 are expected, so that some ten commands are late, and no more."""
    step = trace(tmp_path, np.where(TICKS < 200, 2.0, 12.0))
    late = run("paper_arm", step, f"{EXPECTED}=3", "link.downlink.delay_ms=1", duration_s=0.5)
    counts = playout(late)
    assert counts["arrival_ms"]["max"] == 13.0
    assert counts["horizon_ms"]["max"] == 14.0  # one tick more than the longest
    assert 10 <= counts["late"] <= 40
    assert summarise(late.data())["bounds"]["kept"]


def test_a_command_that_waits_for_its_time_is_within_its_deadline(tmp_path):
    varying = run("paper_arm", trace(tmp_path, PATTERNS["random"](30.0, 1)), f"{EXPECTED}=31")
    assert summarise(varying.data())["timing"]["deadline_misses"] == 0


def test_a_trace_gives_its_quantiles(tmp_path):
    """Of two directions that take 1 to 100 ms, independently, 5 % take longer than 168 ms."""
    override = trace(tmp_path, 1.0 + TICKS % 100)
    link = load_setup("paper_arm", [override]).scenario.link
    delays_ns = configured_delays_ns(link.uplink)
    assert round_trip_ns(delays_ns, delays_ns, 0.95) * 1e-6 == pytest.approx(169.0, abs=2.0)
    assert round_trip_ns(delays_ns, delays_ns[:1], 1.0) == 101_000_000


@pytest.mark.parametrize(
    ("scenario", "overrides", "allowed"),
    [
        ("paper_arm", (), "unless controller.delay_compensation.enabled is true"),
        ("paper_arm_can", (ON,), "a time in ms with link.kind can"),
    ],
)
def test_auto_is_refused_where_no_command_can_say_when_it_acts(scenario, overrides, allowed):
    with pytest.raises(ScenarioError, match=f"link.playout_ms = 'auto': .*{allowed}"):
        load_setup(scenario, [*overrides, "link.playout_ms=auto"])
