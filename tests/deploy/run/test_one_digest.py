"""Under one play-out time d, every pattern of delays up to d gives the same motion, bit for bit.

Patterns are in order, and no message is lost.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
ADAPTIVE = (ON, "controller.law=fixed_time_adaptive")
DRIVES = ("controller.drive_feedback.enabled=true", "plant.drive_feedback.enabled=true")
UP, DOWN = "link.uplink.delay_ms", "link.downlink.delay_ms"


def expected(playout_ms):
    return f"controller.delay_compensation.expected_round_trip_ms={playout_ms}"


def run(arm, *overrides, duration_s=0.15):
    return simulate(load_setup(arm, [f"duration_s={duration_s}", *overrides])).data()


def motion_and_commands(data, playout_ms):
    """The motion, and the torques sent in answer to all states that arrive in every pattern."""
    commands, truth = data.tables["joint_commands"], data.tables["plant_truth"]
    end_ns = len(truth) * data.setup.grid.period_ns - round(1e6 * playout_ms)
    stamps_ns = 1_000_000_000 * commands["header.stamp.sec"].astype(np.int64)
    stamps_ns += commands["header.stamp.nanosec"]
    arrived = stamps_ns < end_ns - 2 * data.setup.grid.period_ns
    assert arrived.any()
    return data.motion, commands["effort"][arrived].tobytes()


def playout_of(data):
    return summarise(data)["transport"]["playout"]


def trace(file: Path, times_s, delays_ms):
    """The section of a direction whose messages are delayed like this from these times on."""
    rows = [f"{at_s:.9f},{delay_ms:.6f}" for at_s, delay_ms in zip(times_s, delays_ms, strict=True)]
    file.write_text("\n".join(["time_s,delay_ms", *rows, "100,0", ""]))
    return f"{{trace: {{file: {file}, start_s: 0}}}}"


@pytest.mark.parametrize(
    ("rate_hz", "more"),
    [(50, ()), (250, ()), (500, ()), (1000, ()), (2000, ()), (50, ("link.playout_ms=40",)),
     (1000, ("link.playout_ms=40",)), (500, ("link.playout_ms=0",)), (1000, DRIVES)],
)  # fmt: skip
def test_whole_ticks_in_one_direction_act_as_the_same_delay_in_both(rate_hz, more):
    """40 ms are whole ticks of all these rates; also without play-out, as the delay is constant."""
    moved = {
        motion_and_commands(
            run("paper_arm", *ADAPTIVE, *more, f"rate_hz={rate_hz}",
                f"{UP}={up_ms}", f"{DOWN}={40 - up_ms}"), 40,
        )
        for up_ms in (40, 0, 20, 39.999)
    }  # fmt: skip
    assert len(moved) == 1


def test_a_state_measured_at_a_tick_names_the_command_that_acts_at_it():
    """The first command acts at 8 ms, so the state of 8 ms is the first that names it."""
    for up_ms in (8, 4, 0):
        status = run("paper_arm", *ADAPTIVE, f"{UP}={up_ms}", f"{DOWN}={8 - up_ms}").tables[
            "plant_status"
        ]
        assert status["command_sequence"][:10].tolist() == [0] * 8 + [1, 2]
        assert status["command_delay_ns"][8:10].tolist() == [8_000_000] * 2


@pytest.mark.parametrize("rate_hz", [250, 1000, 2000])
def test_a_burst_just_after_the_start_acts_as_the_constant_delay_whose_playout_is_set(
    tmp_path, rate_hz
):
    """No delay, with 55.5 ms in each direction from 20 to 24 ms: too rare for a quantile."""
    times_s = 1e-3 * np.arange(3000)
    delays_ms = np.where((times_s > 0.0195) & (times_s < 0.0235), 55.5, 0.0)
    given = trace(tmp_path / "burst.csv", times_s, delays_ms)
    common = (*ADAPTIVE, f"rate_hz={rate_hz}")
    constant = run("paper_arm", *common, f"{UP}=55.5", f"{DOWN}=55.5", duration_s=0.3)
    burst = (f"link.uplink={given}", f"link.downlink={given}")
    varying = run("paper_arm", *common, expected(111), *burst, duration_s=0.3)
    assert motion_and_commands(varying, 111) == motion_and_commands(constant, 111)
    assert playout_of(varying)["late"] == 0
    own = playout_of(run("paper_arm", *common, *burst, duration_s=0.3))
    assert own["horizon_ms"]["p50"] < 111  # what the scenario itself would choose


@pytest.mark.parametrize(
    ("rate_hz", "substeps", "acts_after_ms"),
    [(1000, 3, 112 / 3), (1000, 7, 262 / 7), (300, 4, 45 * 3.333333 / 4), (50, 4, 40.0),
     (2000, 1, 37.5)],
)  # fmt: skip
def test_a_set_playout_ends_at_the_next_physics_step_and_stays(rate_hz, substeps, acts_after_ms):
    """37.3 ms; the period is not always a whole number of ns in each step."""
    steps = (f"rate_hz={rate_hz}", f"plant.substeps={substeps}")
    common = ("paper_arm", *ADAPTIVE, *steps, expected(37.3))
    data = run(*common, f"{UP}=18", duration_s=0.3)
    found = playout_of(data)
    assert found["late"] == 0
    for which in ("p50", "max"):
        assert found["horizon_ms"][which] == pytest.approx(acts_after_ms, abs=0.002)
    assert run(*common, f"{UP}=37.3", duration_s=0.3).motion == data.motion


def test_first_commands_may_come_later_than_the_mean_of_the_link_allows(tmp_path):
    """Messages of the first 4 ms take 260 ms, all others none; the watchdog allows 200."""
    given = trace(tmp_path / "late.csv", 1e-3 * np.arange(3000), [260.0] * 4 + [0.0] * 2996)
    common = ("paper_arm", *ADAPTIVE, expected(260))
    constant = run(*common, f"{UP}=260", duration_s=0.5)
    varying = run(*common, f"link.uplink={given}", duration_s=0.5)
    assert not varying.faults()
    assert motion_and_commands(varying, 260) == motion_and_commands(constant, 260)


SETTINGS = {
    "adaptive": ("paper_arm", 24.0, (*ADAPTIVE, expected(24))),
    "slow, three steps": ("paper_arm", 47.3, (*ADAPTIVE, expected(47.3), "rate_hz=50",
                                              "plant.substeps=3")),
    "fast, one step": ("paper_arm", 8.0, (ON, expected(8), "rate_hz=2000", "plant.substeps=1")),
    "drives, bridge": ("paper_arm", 16.0, (*ADAPTIVE, expected(16), *DRIVES, "rate_hz=500",
                                           "controller.delay_compensation.bridge_ms=20")),
    "below a tick": ("paper_arm", 0.75, (*ADAPTIVE, expected(0.75))),
    "fixed": ("paper_arm", 20.0, (*ADAPTIVE, "link.playout_ms=20", "rate_hz=250")),
    "no compensation": ("paper_arm", 12.0, ("controller.law=smc", "link.playout_ms=12")),
    "motors": ("panda_motors", 30.0, (*ADAPTIVE, expected(30), "rate_hz=500")),
    "smith": ("paper_arm", 24.0, (ON, expected(24),
                                  "controller.delay_compensation.predictor=smith")),
}  # fmt: skip
"""Arm, d in ms and overrides."""


@cache
def constant(name):
    arm, playout_ms, overrides = SETTINGS[name]
    half = (f"{UP}={playout_ms / 2}", f"{DOWN}={playout_ms / 2}")
    return motion_and_commands(run(arm, *overrides, *half), playout_ms)


SHARES = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.0, 1.0))


@settings(
    max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck),
    phases=[Phase.generate],
)  # fmt: skip
@given(
    name=st.sampled_from(sorted(SETTINGS)),
    split=SHARES,
    of_whole_ticks=st.booleans(),
    shares=st.tuples(*2 * [st.lists(SHARES, min_size=2, max_size=40)]),
)
def test_all_patterns_below_a_playout_give_one_digest(
    tmp_path_factory, name, split, of_whole_ticks, shares
):
    """Each direction takes shares of its part of d, a new one after every tick, then again."""
    arm, playout_ms, overrides = SETTINGS[name]
    tick_ms = 1e3 / next((float(o[8:]) for o in overrides if o.startswith("rate_hz=")), 1000.0)
    parts_ms = {"uplink": split * playout_ms, "downlink": (1.0 - split) * playout_ms}
    folder, link = tmp_path_factory.mktemp("traces"), []
    for way, own in zip(parts_ms, shares, strict=True):
        delays_ms = np.resize(own, round(200 / tick_ms)) * parts_ms[way]
        if of_whole_ticks:
            delays_ms = np.floor(delays_ms / tick_ms) * tick_ms
        delays_ms = np.floor(1e6 * delays_ms) * 1e-6  # rounded up, both may exceed d by 1 ns
        times_s = 1e-3 * tick_ms * np.arange(len(delays_ms))
        link.append(f"link.{way}={trace(folder / way, times_s, delays_ms)}")
    varying = run(arm, *overrides, *link)
    assert motion_and_commands(varying, playout_ms) == constant(name)
    assert playout_of(varying)["late"] == 0
