"""The judge around missing ticks: rows on both sides of a gap are no neighbours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus_schema.messages.topics import JOINT_COMMANDS, PLANT_TRUTH, Topic
from deploy.judge.findings.chattering import chatter_shares
from deploy.judge.metrics import RunResult, summarise
from deploy.judge.run_data import build_run_data
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.scenario.scenario import load_setup
from tests.deploy.judge.made_up_messages import rows

STILL = "{kind: joint_sinusoids, centre_rad: 0, terms: [{amplitude_rad: 0, frequency_rad_s: 1}]}"


def messages(topic: Topic, ticks: np.ndarray, **columns: np.ndarray) -> list[bytes]:
    """Messages of some ticks, 1 ms each; each column has a value for each of all ticks."""

    def at(tick: int) -> dict[str, Any]:
        values = {name: values[tick] for name, values in columns.items()}
        return {"stamp_ns": int(tick) * 1_000_000, **values}

    return rows(topic, *map(at, ticks))


def run_of(ticks, errors_rad, torques_nm, met, commanded=None):
    """A run of which these ticks are known, with the same error and torque for all joints.

    Args:
        commanded: ticks of which the command is known, if not the same.
    """
    setup = load_setup("paper_arm", [f"reference={STILL}", "metrics.from_s=0"])
    met = np.asarray(met, dtype=np.uint8)
    payloads = {
        PLANT_TRUTH.name: messages(PLANT_TRUTH, ticks, position=errors_rad, deadline_met=met),
        JOINT_COMMANDS.name: messages(
            JOINT_COMMANDS, ticks if commanded is None else commanded, effort=torques_nm
        ),
    }
    return build_run_data(setup, payloads, clock="lockstep", link="zenoh")


def test_what_rests_on_neighbours_stops_at_a_gap() -> None:
    ticks = np.array([0, 1, 2, 3, 4, 10, 11, 12])
    errors_rad = np.where(np.arange(13) < 5, 0.1, 0.0)
    torques_nm = np.array([0, 1, 2, 3, 4, 0, 0, 0, 0, 0, 104, 105, 106], dtype=float)
    missed = np.isin(np.arange(13), [3, 4, 10, 11, 12])
    run = run_of(ticks, errors_rad, torques_nm, ~missed)
    summary = summarise(run)
    torque, tracking = summary["torque"], summary["tracking"]
    assert torque["total_variation_nm_per_s"] == pytest.approx([1000.0] * 3)
    assert summary["recording"]["torque_left_out_s"] == pytest.approx(0.006)
    assert summary["timing"]["deadline_miss_longest_run"] == 3
    assert tracking["settling_time_s"] == pytest.approx([0.010] * 3)
    assert summary["recording"]["settling_is_latest"] == [True] * 3
    assert tracking["rms_rad"] == pytest.approx([np.sqrt(5 / 8) * 0.1] * 3)
    text = " ".join(verdict_on_run(JudgedRun("", run, RunResult(**summary))).reasons)
    assert "known at 7 of 12 ticks" in text
    assert "because ticks are missing: base_yaw, shoulder, elbow." in text
    assert "leave out 0.006 s around the gaps" in text


@pytest.mark.parametrize(
    ("ticks", "commanded"),
    [
        ([0, 1, 2, 3, 4, 11, 12], [0, 1, 2, 3, 10, 11, 12]),
        ([0, 1, 2, 3, 4, 11, 12], [0, 1, 2, 3, 4, 5, 10, 11, 12]),
        ([0, 1, 2, 3, 4, 10, 11, 12], [0, 1, 2, 3, 4, 12]),
    ],
    ids=["command before its truth", "on both sides", "fewer commands"],
)
def test_torques_stop_at_a_gap_for_any_first_message_after_it(ticks, commanded):
    """A loop sends the truth of a tick after what it has of the command for it."""
    every = np.arange(13)
    torques_nm = np.where(every < 8, 1.0, 101.0) + every
    run = run_of(np.array(ticks), 0.0 * every, torques_nm, every < 99, np.array(commanded))
    summary = summarise(run)
    assert summary["torque"]["total_variation_nm_per_s"] == pytest.approx([1000.0] * 3)
    left_out_s = max(np.diff(commanded)) * 1e-3
    assert summary["recording"]["torque_left_out_s"] == pytest.approx(left_out_s)


def test_a_run_that_never_began_is_judged() -> None:
    none = np.zeros(0, dtype=int)
    summary = summarise(run_of(none, none, none, none))
    assert summary["ticks"] == 0
    assert summary["torque"]["total_variation_nm_per_s"] is None
    assert summary["recording"]["torque_left_out_s"] == 0.0


def test_nothing_is_left_out_where_nothing_is_missing() -> None:
    ticks = np.arange(13)
    errors_rad = np.where(ticks < 5, 0.1, 0.0)
    run = run_of(ticks, errors_rad, 1.0 * ticks, ticks < 99)
    summary = summarise(run)
    assert summary["recording"]["torque_left_out_s"] == 0.0
    assert summary["torque"]["total_variation_nm_per_s"] == pytest.approx([1000.0] * 3)
    assert summary["recording"]["settling_is_latest"] == [False] * 3
    assert "latest" not in " ".join(
        verdict_on_run(JudgedRun("", run, RunResult(**summary))).reasons
    )


def test_a_jump_over_a_gap_is_no_chatter() -> None:
    slow = 3.0 * np.sin(2 * np.pi * 0.5 * np.arange(6000) / 1000.0)[:, None]
    known = np.delete(slow, np.s_[2100:3100], axis=0)  # from one flank to the other
    assert chatter_shares(known, 1000.0)[0] > 1e-4
    assert chatter_shares(known, 1000.0, np.array([2100]))[0] < 1e-6
