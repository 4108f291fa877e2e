"""Fuzzing in short; `scripts/fuzz` does the same at length."""

from __future__ import annotations

import logging
import os
import signal

import pytest
from can_frames import CanTarget
from decoding import Target
from forked import try_forked
from recordings import try_recordings
from scenarios import try_files

from bus_schema.recording.mcap_log import read_log
from tests.plant_emulator.drives.dialects import DIALECTS

MUTATIONS = 20_000
FRAMES = 3_500


def test_mutations_crash_nothing_and_no_wrong_command_comes_through(tmp_path):
    target = Target(seed=7, folder=tmp_path)
    for _ in range(MUTATIONS):
        target.attack()
    target.close()
    assert sum(target.kinds.values()) == MUTATIONS
    assert target.accepted > 100  # else the checks of what comes through check nothing
    assert set(target.rejected) >= {"malformed", "not_finite", "stale", "replayed", "wrong_names"}
    assert len(target.rejected) <= 9  # reasons are ours, not the attacker's: counters are bounded
    assert read_log(tmp_path / "fuzz.mcap").complete


@pytest.mark.parametrize("protocol", DIALECTS)
def test_mutated_frames_crash_no_drive_and_give_no_torque_but_what_they_say(
    protocol, tmp_path, caplog
):
    caplog.set_level(logging.CRITICAL)
    target = CanTarget(protocol, 5, tmp_path)
    for _ in range(FRAMES):
        target.attack()
    assert sum(target.kinds.values()) == FRAMES
    assert target.commanded > 20  # else the check of torques checks nothing
    assert sum(target.reasons.values()) > FRAMES // 2
    assert len(target.reasons) <= 12  # counters are bounded: reasons are ours


def test_no_damaged_recording_is_taken_for_whole(tmp_path):
    outcomes = try_recordings(100, 3, tmp_path)
    assert set(outcomes) == {
        "refused", "judged, all messages there", "judged as far as can be read",
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["scenario", "urdf"])
def test_mutated_file_runs_or_is_refused(kind, tmp_path):
    outcomes = try_files(kind, range(100), 11, tmp_path)
    assert not outcomes.findings
    assert outcomes.counts["ran"] > 5
    assert outcomes.counts["refused"] > 10


def _raise(_number):
    raise RecursionError


@pytest.mark.parametrize(
    ("trial", "message"),
    [
        (_raise, "RecursionError"),
        (lambda number: os.kill(os.getpid(), signal.SIGSEGV), "died"),
        (lambda number: str(len(bytearray(8 << 30))), "MemoryError"),
    ],
    ids=["raises", "crashes", "is greedy"],
)
def test_a_trial_that_goes_wrong_is_a_finding(trial, message):
    outcomes = try_forked(lambda number: "ran" if number != 4 else trial(number), range(3, 6))
    assert outcomes.counts == {"ran": 2, "finding": 1}
    assert list(outcomes.findings) == [4]
    assert message in outcomes.findings[4]
