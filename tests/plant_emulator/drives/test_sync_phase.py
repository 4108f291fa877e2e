"""The plant's clock in real time: that of the master's cycle, however late its frames are read.

Time is the test's: a master that sends on its grid, a plant that reads when the test says.
"""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from plant_emulator.drives.sync_phase import SyncPhase

MS = 1_000_000
PERIOD_NS, LEAD_NS = 2 * MS, 300_000


def error_after(read_ns: Iterable[int], off_ns: int = 0, drift: float = 0.0) -> int:
    """By how much the clock is off in the end.

    Args:
        read_ns: when samplings are read, in the master's time.
        off_ns: how much the clock is behind when it starts.
        drift: how much faster than the plant's the master's clock is.
    """
    phase, behind_ns, at_ns = SyncPhase(PERIOD_NS, LEAD_NS), off_ns, 0
    for now_ns in read_ns:
        behind_ns += round(drift * (now_ns - at_ns))
        at_ns = now_ns
        behind_ns -= phase.correction_ns(now_ns + LEAD_NS - behind_ns)
    return behind_ns


def in_time(ticks: int, noise_ns: int = 0) -> list[int]:
    noise = random.Random(1)
    return [tick * PERIOD_NS + noise.randint(0, noise_ns) for tick in range(ticks)]


@pytest.mark.parametrize("held_up_ns", [300_000, 7 * MS, 31 * MS])
def test_start_that_is_read_late_is_mended_as_soon_as_a_sampling_is_read_in_time(held_up_ns):
    # What was sent meanwhile waited, and is read at once.
    read_ns = [max(sent_ns, held_up_ns) for sent_ns in in_time(24)]
    assert error_after(read_ns, off_ns=held_up_ns) == 0


def test_samplings_that_are_read_late_put_nothing_forward() -> None:
    held_up = in_time(500, 40_000)
    for at in range(100, 500, 50):
        held_up[at : at + 6] = [held_up[at + 6]] * 6  # six of them read in one go
    assert abs(error_after(held_up)) < 60_000


@pytest.mark.parametrize("drift", [2e-4, -2e-4])
def test_clocks_that_drift_apart_stay_together(drift: float) -> None:
    read_ns = in_time(20_000, 40_000)
    assert abs(error_after(read_ns, drift=drift)) < 60_000
    assert abs(drift * read_ns[-1]) > PERIOD_NS  # which is what it would come to


def test_samplings_at_twice_the_rate_do_not_run_away_with_the_clock() -> None:
    at_most_ns = 25 * PERIOD_NS // 2 + round(5e-4 * 2000 * PERIOD_NS)
    assert abs(error_after([sent_ns // 2 for sent_ns in in_time(2000)])) <= at_most_ns
