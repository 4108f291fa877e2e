"""The judge, on runs so small that every number can be worked out by hand.

The arm is the three-joint one, held at zero: the recorded position is the error. It starts 0.1 rad
above, so the funnel opens to 1.2 · 0.1 + 0.05 = 0.17 rad above and to 0.4 · 0.1 + 0.03 = 0.07 rad
below; it closes to 0.01 rad at 1000 per second, so after 10 ms it is there to 1e-4 of its opening.
"""

from __future__ import annotations

import hashlib
import json
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import (
    CONTROL_STATUS,
    JOINT_COMMANDS,
    PLANT_TRUTH,
    RUN_EVENTS,
)
from deploy.judge.findings.link_delays import measured_link
from deploy.judge.metrics import RunResult, summarise
from deploy.judge.result.tracking import settling_times_s
from deploy.judge.run_data import build_run_data, digest
from deploy.judge.run_rows import row
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from tests.deploy.judge.made_up_messages import JOINTS, rows

UPPER_RAD, LOWER_RAD, FINAL_RAD = 0.17, 0.07, 0.01


@pytest.fixture(scope="module")
def setup() -> Setup:
    return load_setup(
        "paper_arm",
        [
            "reference={kind: joint_sinusoids, centre_rad: 0,"
            " terms: [{amplitude_rad: 0, frequency_rad_s: 1}]}",
            "robot.initial_offset_rad=0.1",
            "funnel.rate_per_s=1000",
            "metrics.from_s=0.010",
        ],
    )


def judged(setup: Setup, *messages: Sequence[dict[str, Any]], **others: list[bytes]) -> Any:
    return summarise(run_of(setup, *messages, **others))


def run_of(setup, truth=(), commands=(), **others):
    payloads = {
        PLANT_TRUTH.name: rows(PLANT_TRUTH, *truth),
        JOINT_COMMANDS.name: rows(JOINT_COMMANDS, *commands),
        **others,
    }
    return build_run_data(setup, payloads, clock="lockstep", link="zenoh", lost={"joint_states": 3})


def at(*errors_rad: float, **values: Any) -> dict[str, Any]:
    """One tick with an error per joint, or the same for all."""
    return {"position": errors_rad if len(errors_rad) == 3 else errors_rad[0], **values}


def test_errors_inside_leave_the_bounds_at_no_tick(setup: Setup) -> None:
    bounds = judged(setup, [at(0.1, -0.035, 0.0), at(0.0)])["bounds"]
    assert bounds == {
        "kept": False,  # as nothing says how the run ended
        "violation_fraction": 0.0,
        "first_violation_s": None,
        # 0.1 of 0.17 above leaves 41 %, 0.035 of 0.07 below leaves 50 %
        "margin_min": pytest.approx(1.0 - 0.1 / UPPER_RAD),
        "margin_min_joint": "base_yaw",
        "margin_min_s": 0.0,
        "margin_start": pytest.approx(1.0 - 0.1 / UPPER_RAD),
        "margin_steady": None,  # over before `metrics.from_s`
    }


def test_margins_name_joint_and_time_and_tell_the_start_from_the_steady_state(setup: Setup) -> None:
    errors = [at(0.05, 0.0, 0.0), at(0.0, 0.0, -0.04), *[at(0.0)] * 2998]
    errors[2500] = at(0.0, 0.001, 0.0)
    bounds = judged(setup, errors)["bounds"]
    assert (bounds["margin_min_joint"], bounds["margin_min_s"]) == ("elbow", pytest.approx(0.001))
    assert bounds["margin_start"] == pytest.approx(1.0 - 0.05 / UPPER_RAD)
    assert bounds["margin_steady"] == pytest.approx(0.9, abs=1e-3)  # 1 of 10 mrad


def test_each_side_of_the_funnel_has_its_own_width(setup: Setup) -> None:
    assert judged(setup, [at(0.08), at(0.0)])["bounds"]["violation_fraction"] == 0.0
    below = judged(setup, [at(-0.08), at(0.0)])["bounds"]
    assert below["violation_fraction"] == 0.5
    assert below["margin_min"] == pytest.approx(1.0 - 0.08 / LOWER_RAD)


def test_error_on_the_bound_is_outside(setup: Setup) -> None:
    for factor, fraction in ((1 - 1e-9, 0.0), (1 + 1e-9, 0.5)):
        bounds = judged(setup, [at(UPPER_RAD * factor), at(0.0)])["bounds"]
        assert bounds["violation_fraction"] == fraction


def test_violations_are_ticks_at_which_any_joint_is_outside(setup: Setup) -> None:
    truth = [at(0.1)] + [at(0.0)] * 19  # ticks 0 to 19
    truth[12] = at(0.0, 0.02, 0.0)
    truth[15] = at(0.02, 0.02, -0.02)
    truth[16] = at(0.0, 0.0, -0.011)
    bounds = judged(setup, truth)["bounds"]
    assert bounds["violation_fraction"] == pytest.approx(3 / 20)
    assert bounds["first_violation_s"] == pytest.approx(0.012)
    assert bounds["margin_min"] == pytest.approx(-1.0, abs=1e-3)  # twice the width


def test_where_the_arm_stood_before_any_tick_is_not_judged(setup: Setup) -> None:
    for place_rad in (0.0, 1.0):
        run = replace(run_of(setup, [at(place_rad)]), failures=["the controller is gone"])
        summary = summarise(run)
        assert summary["ticks"] == 0
        assert summary["bounds"]["kept"] is False
        assert summary["bounds"]["violation_fraction"] is None
        verdict = verdict_on_run(JudgedRun("", run, RunResult(**summary)))
        assert verdict.headline == "Run ended by a fault"
        assert verdict.reasons[0] == "No tick was recorded, so there is no verdict on the bounds."


def test_tracking_counts_from_the_time_the_scenario_says(setup: Setup) -> None:
    # ticks 0 to 9 do not count; from 10 ms on the errors are 3 and 4 mrad: RMS √12.5
    truth = [at(0.1)] + [at(0.05)] * 9 + [at(0.003, 0.0, -0.003), at(-0.004, 0.0, 0.004)]
    tracking = judged(setup, truth)["tracking"]
    assert tracking["joint_names"] == list(JOINTS)
    assert tracking["rms_rad"] == pytest.approx([np.sqrt(12.5e-6), 0.0, np.sqrt(12.5e-6)])
    assert tracking["max_abs_rad"] == pytest.approx([0.004, 0.0, 0.004])


def test_settling_is_the_last_entry_into_the_band() -> None:
    times_s = np.arange(5) * 0.1
    band = np.array([0.01])
    cases = {
        (0.1, 0.1, 0.0, 0.0, 0.0): 0.2,
        (0.1, 0.0, -0.1, 0.0, 0.0): 0.3,  # it left once more
        (0.0, 0.0, 0.0, 0.0, 0.0): 0.0,
        (0.1, 0.01, 0.01, 0.01, 0.01): 0.1,  # the edge belongs to the band
        (0.1, 0.0, 0.0, 0.0, 0.1): None,
    }
    for errors, expected in cases.items():
        assert settling_times_s(np.array([errors]).T, times_s, band) == [
            None if expected is None else pytest.approx(expected)
        ]


def test_tip_error_is_the_distance_that_the_joints_make(setup: Setup) -> None:
    """An arm of 0.7 and 0.6 m lies straight along x: a turned base moves its end on a circle."""
    ticks = [at(1.0)] * 10  # before `metrics.from_s`, 10 ms
    ticks += [at(0.02, 0.0, 0.0), at(-0.03, 0.0, 0.0), at(0.0), at(0.0, 0.0, 0.01)]
    found = judged(setup, ticks)["tip_error_mm"]
    chords = [2e3 * r * np.sin(e / 2) for r, e in ((1.3, 0.02), (1.3, 0.03), (1, 0), (0.6, 0.01))]
    assert found["largest"] == pytest.approx(max(chords), rel=1e-9)
    assert found["rms"] == pytest.approx(np.sqrt(np.mean(np.square(chords))), rel=1e-9)


@pytest.mark.parametrize("ticks", [[], [at(0.0)] * 5, [at(0.0)] * 12 + [at(np.nan)]])
def test_tip_error_is_unknown_without_positions(setup: Setup, ticks) -> None:
    found = judged(setup, ticks)
    assert found["tip_error_mm"] == {"rms": None, "largest": None, "at_loss": None}
    assert row(RunResult(**found), 1)["tip_largest_mm"] is None


def test_tip_error_is_unknown_where_no_joint_moves_the_tip(setup: Setup) -> None:
    """The first link's frame is on the first axis, as the only frame of an arm of one joint is."""
    first = ET.fromstring(setup.robot.text).find(f"joint[@name='{JOINTS[0]}']/child").get("link")
    robot = replace(setup.robot, tip_link=first)
    found = judged(replace(setup, robot=robot), [at(0.02, 0.0, 0.0)] * 12)
    assert found["tip_error_mm"] == {"rms": None, "largest": None, "at_loss": None}


def test_torque_figures(setup: Setup) -> None:
    commands = [{"effort": effort} for effort in ([3, 0, -1], [-4, 0, 1], [3, 0, -1])]
    truth = [at(0.0, saturated=flag) for flag in (0, 1, 0, 0)]
    torque = judged(setup, truth, commands)["torque"]
    # 7 + 7 and 2 + 2 N m in the 2 ms from the first command to the last
    assert torque["total_variation_nm_per_s"] == pytest.approx([7000.0, 0.0, 2000.0])
    assert torque["rms_nm"] == pytest.approx([np.sqrt(34 / 3), 0.0, 1.0])
    assert torque["peak_nm"] == [4.0, 0.0, 1.0]
    assert torque["saturated_fraction"] == 0.25


def test_torques_of_drives_with_their_own_loops_are_the_delivered_ones(setup: Setup) -> None:
    """The commands are positions; before the first one acts, nothing is judged."""
    commands = [{"effort": [0, 0, 0]}] * 3
    truth = [
        at(0.0, torque=torque, command_age_ns=age)
        for torque, age in (([9, 9, 9], -1), ([3, 0, -1], 1), ([-4, 0, 1], 1), ([3, 0, -1], 1))
    ]
    torque = judged(setup, truth, commands)["torque"]
    assert torque["total_variation_nm_per_s"] == pytest.approx([7000.0, 0.0, 2000.0])
    assert torque["rms_nm"] == pytest.approx([np.sqrt(34 / 3), 0.0, 1.0])
    assert torque["peak_nm"] == [4.0, 0.0, 1.0]


def test_torque_commands_are_judged_as_commanded_whatever_is_delivered(setup: Setup) -> None:
    commands = [{"effort": [2, 0, 0]}, {"effort": [4, 0, 0]}]
    truth = [at(0.0, torque=[9, 9, 9], command_age_ns=1)] * 3
    torque = judged(setup, truth, commands)["torque"]
    assert torque["peak_nm"] == [4.0, 0.0, 0.0]


def test_timing_leaves_out_what_is_not_known(setup: Setup) -> None:
    skipped = {"timing.lateness_ns": -1}
    unknown = {"command_age_ns": -1, "round_trip_ns": -1, "state_age_ns": -1, **skipped}
    known = {"command_age_ns": 6_000_000, "round_trip_ns": 5_000_000, "state_age_ns": 2_000_000}
    known["timing.lateness_ns"] = 1_500
    summary = judged(
        setup,
        [at(0.0, **unknown), at(0.0, **known), at(0.0, **unknown)],
        control_status=rows(CONTROL_STATUS, {"timing.step_ns": 40_000}, {"timing.step_ns": 60_000}),
    )["timing"]
    assert set(summary["command_age_us"].values()) == {6000.0}
    assert set(summary["round_trip_us"].values()) == {5000.0}
    assert set(summary["state_age_us"].values()) == {2000.0}
    assert (summary["control_step_us"]["p50"], summary["control_step_us"]["max"]) == (40.0, 60.0)
    assert summary["wakeup_lateness_us"]["max"] == 1.5


@pytest.mark.parametrize(
    ("met", "misses", "longest"),
    [("1111", 0, 0), ("1011", 1, 1), ("0110", 2, 1), ("1001000", 5, 3), ("0000", 4, 4)],
)
def test_misses_and_the_longest_run_of_them(setup, met, misses, longest):
    timing = judged(setup, [at(0.0, deadline_met=int(flag)) for flag in met])["timing"]
    assert (timing["deadline_misses"], timing["deadline_miss_longest_run"]) == (misses, longest)


def test_events_determine_how_a_run_ended(setup: Setup) -> None:
    counts = {"sent": 9, "delivered": 8, "lost": 1, "duplicated": 0, "reordered": 0,
              "rejected": {"stale": 2}}  # fmt: skip
    events = [
        RunEvent(2_000_000, "plant", EventKind.FAULT, "it broke"),
        RunEvent(2_000_000, "plant", EventKind.COUNTS, f'{{"uplink": {{}}, "downlink": {counts}}}'
                 .replace("'", '"')),
        RunEvent(2_000_000, "plant", EventKind.ENDED,
                 '{"completed": true, "ticks": 4, "wall_s": 0.002, "stolen_ms": 1.0}'),
    ]  # fmt: skip
    truth = [at(0.0, deadline_met=flag) for flag in (1, 0, 1, 1, 1)]
    run = run_of(setup, truth, **{RUN_EVENTS.name: [event.encode() for event in events]})
    # What a hypervisor took away matters only where time is the machine's own.
    stolen = {
        clock: summarise(replace(run, clock=clock))["timing"]["stolen_ms"]
        for clock in ("realtime", "lockstep", "virtual")
    }
    assert stolen == {"realtime": 1.0, "lockstep": None, "virtual": None}
    summary = summarise(run)
    assert summary["completed"] is False
    assert summary["verdict"] == "faulted"
    assert summary["ticks"] == 4
    assert summary["duration_s"] == pytest.approx(0.004)
    assert summary["real_time_factor"] == pytest.approx(2.0)
    assert summary["timing"]["success_rate"] == pytest.approx(0.75)  # 1 miss in 4 ticks
    assert summary["faults"] == ["plant at 0.002 s: it broke"]
    unmeasured = dict.fromkeys(("p50", "p99", "p99_9", "max"))
    assert summary["transport"]["downlink"] == counts | {"measured_ms": unmeasured}
    assert summary["recorder"] == {
        "messages": 5 + 3, "lost": 3, "lost_by_topic": {"joint_states": 3}, "complete": True
    }  # fmt: skip


def test_digest_depends_on_every_byte_and_on_the_order(setup: Setup) -> None:
    first, second = {"effort": [1.0, 2.0, 3.0]}, {"effort": [1.0, 2.0, 3.0 + 1e-15]}

    def digest(*commands: dict[str, Any]) -> str:
        return run_of(setup, commands=commands).digest

    assert digest(first, second) == digest(first, second)
    assert len({digest(first), digest(second), digest(first, second), digest(second, first)}) == 4


def stall_ms(setup: Setup, truth: list[dict[str, Any]], status: list[dict[str, Any]]) -> Any:
    """The longest stall of a run in real time."""
    recorded = run_of(setup, truth, control_status=rows(CONTROL_STATUS, *status))
    return summarise(replace(recorded, clock="realtime"))["timing"]["longest_stall_ms"]


def answered(cycle: int, period_ms: float, **values: Any) -> dict[str, Any]:
    return {"timing.cycle": cycle, "timing.period_ns": round(period_ms * 1e6), **values}


def test_stall_is_the_worst_that_any_loop_met(setup: Setup) -> None:
    late = {"timing.lateness_ns": 31_000_000}
    slept = [at(0.0, **{"timing.lateness_ns": -1})] * 40
    steady = [answered(0, 0.0), answered(1, 1.0)]
    slow = [answered(0, 0.0, **{"timing.step_ns": 52_000_000}), answered(1, 1.0)]
    assert stall_ms(setup, [at(0.0), at(0.0)], steady) == 0.0
    assert stall_ms(setup, [at(0.0), at(0.0, **late)], steady) == pytest.approx(31.0)
    assert stall_ms(setup, [at(0.0), *slept, at(0.0)], steady) == pytest.approx(40.0)
    assert stall_ms(setup, [at(0.0)], slow) == pytest.approx(52.0)


def test_states_that_come_late_to_the_controller_are_a_stall(setup: Setup) -> None:
    status = [answered(0, 0.0), answered(1, 1.2), answered(2, 101.0), answered(3, 0.1)]
    assert stall_ms(setup, [at(0.0)], status) == pytest.approx(100.0)
    jittery = [at(0.0, state_age_ns=2_000_000), at(0.0, state_age_ns=42_000_000)]
    assert stall_ms(setup, jittery, status) == pytest.approx(60.0)


@pytest.mark.parametrize(
    "status",
    [
        [answered(0, 0.0), answered(1, 80.0, stamp_ns=80_000_000)],
        [answered(700, 1.0, stamp_ns=5_000_000), answered(0, 300.0, stamp_ns=6_000_000)],
    ],
    ids=["states were lost", "another controller took over"],
)
def test_what_is_no_stall(setup: Setup, status: list[dict[str, Any]]) -> None:
    assert stall_ms(setup, [at(0.0)], status) == 0.0


def test_virtual_time_knows_no_stall(setup: Setup) -> None:
    late = at(0.0, **{"timing.lateness_ns": 31_000_000})
    assert judged(setup, [late])["timing"]["longest_stall_ms"] is None


def test_digest_does_not_count_how_often_the_first_state_was_sent() -> None:
    once = digest([b"s0", b"s1"], [b"c0", b"c1"])
    assert digest([b"s0", b"s0", b"s0", b"s1"], [b"c0", b"c0", b"c1"]) == once
    assert digest([b"s0", b"s1", b"s1"], [b"c0", b"c1"]) != once
    assert digest([], []) == hashlib.sha256().hexdigest()


@pytest.mark.parametrize(
    "message", [{"kernel": 7, "cycles": 10}, {"kernel": 7, "cycles": 2**52, "newest_cycle_s": 1.0}]
)
def test_ends_that_lack_values_or_exaggerate_measure_no_link(message: dict[str, float]) -> None:
    """Any program on the bus may send them."""
    run = simulate(load_setup("paper_arm", ["duration_s=0.01"])).data()
    others = [event for event in run.events if event.kind != EventKind.ENDED]
    ends = [
        RunEvent(10**7, "plant", EventKind.ENDED, json.dumps({"kernel": 7, "start_s": 0.0})),
        RunEvent(10**7, "controller", EventKind.ENDED, json.dumps(message)),
    ]
    found = measured_link(replace(run, clock="realtime", events=[*others, *ends]))
    assert [len(each.delays_ms) for each in found.values()] == [0, 0]
