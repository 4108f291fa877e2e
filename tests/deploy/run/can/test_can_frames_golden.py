"""The frames of every shipped CAN scenario, byte for byte and bit time by bit time.

However fast frames are packed, carried and logged: which ones there are, and when they are through
on the wire, is fixed. The digests of cycles are those of the first, plain way of doing it; those of
start-up change with what drives say of themselves.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

from tests.deploy.run.can.can_runs import CANSIMPLE, FEEDBACK, run_over_can

FIRST_OF_CYCLE = {
    "cia402": r"080#",  # SYNC
    "cansimple": r"029#R",  # the first axis is asked for its estimates
    "mit": r"001#(?!FFFFFFFFFFFFFF)",  # the first motor is commanded
}
GIVEN_UP = re.compile(r"6..#80.{6}00000405")
"""A client's SDO abort of a request that timed out (CiA 301, 7.2.4.3.17, code 0504 0000h)."""
TICKS = 300


def digests(folder: Path, scenario: str, *overrides: str) -> tuple[str, str]:
    """Of the start, and of the first ticks.

    Start-up may repeat requests on a slow machine, and the master gives up those that are answered
    too late: so its frames count once each, without order and without what gives up a request, and
    bus time is counted from the first cycle on.
    """
    run = run_over_can(scenario, "duration_s=0.8", *overrides, folder=folder)
    fields = [line.split() for line in (folder / "can.log").read_text().splitlines()]
    times_us = [round(float(field[0].strip("()")) * 1e6) for field in fields]
    frames = run.logged
    pattern = re.compile(FIRST_OF_CYCLE[run.data.setup.scenario.link.can.protocol])
    cycles = [number for number, frame in enumerate(frames) if pattern.match(frame)]
    first, end = cycles[0], cycles[TICKS]
    timed = [f"{times_us[n] - times_us[first]} {frames[n]}" for n in range(first, end)]
    of_start = {frame for frame in frames[:first] if not GIVEN_UP.match(frame)}
    return digest(sorted(of_start)), digest(timed)


def digest(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


@pytest.mark.parametrize(
    ("scenario", "overrides", "start", "cycles"),
    [
        ("paper_arm_can", [], "03d7fc45dd037306", "e027c8181c8b5b29"),
        ("paper_arm_can", [CANSIMPLE[0]], "9c4c1533ab971bba", "e128a8668c39e975"),
        ("paper_arm_can", [FEEDBACK], "e97df6dbdbe8cd91", "4f7919bfa418de5f"),
        ("paper_arm_can", [*CANSIMPLE, FEEDBACK], "b813113df2ee1abe", "c79adda173c1d0cc"),
        ("paper_arm_mit", [], "9abd708122f30be9", "fe559e0c931eceff"),
        ("paper_arm_mit", [FEEDBACK], "9abd708122f30be9", "bc930cfb469e7e3d"),
    ],
)
def test_frames_equal_the_stored_ones(scenario, overrides, start, cycles, tmp_path):
    assert digests(tmp_path, scenario, *overrides) == (start, cycles)
