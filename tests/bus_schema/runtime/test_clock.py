import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.runtime.clock import MonotonicClock, TickGrid, VirtualClock

RATES_HZ = [1.0, 3.0, 7.0, 60.0, 333.0, 1000.0, 1024.0, 9999.0]
SUBSTEPS = [1, 3, 4, 7, 100]
HOUR_NS = 3_600_000_000_000


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_period_is_the_nearest_nanosecond_and_does_not_drift_in_a_million_ticks(rate_hz):
    grid = TickGrid(rate_hz, 4)
    assert abs(grid.period_ns - 1e9 / rate_hz) <= 0.5
    assert grid.tick_ns(10**6) == 10**6 * grid.period_ns
    assert grid.tick_at_or_before(grid.tick_ns(10**6)) == 10**6
    assert grid.tick_at_or_before(grid.tick_ns(10**6) - 1) == 10**6 - 1


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("substeps", SUBSTEPS)
@pytest.mark.parametrize("tick", [0, 1, 10**6])
def test_substeps_partition_a_tick(rate_hz, substeps, tick):
    grid = TickGrid(rate_hz, substeps)
    starts = [grid.substep_ns(tick * substeps + substep) for substep in range(substeps + 1)]
    assert starts[0] == grid.tick_ns(tick)
    assert starts[-1] == grid.tick_ns(tick + 1)
    lengths = [b - a for a, b in zip(starts, starts[1:], strict=False)]
    # Whole nanoseconds: no substep differs from the physics step by a full one.
    assert all(abs(length - grid.substep_s * 1e9) < 1.0 for length in lengths)


@pytest.mark.parametrize("substeps", SUBSTEPS)
def test_stages_hold_each_substep_once_and_in_order(substeps):
    grid = TickGrid(1000.0, substeps)
    stages = grid.stages()
    assert [substep for stage in stages for substep in stage] == list(range(substeps))
    assert len(stages[-1]) == 1  # only the last one is left to the end of the tick


@given(st.floats(1.0, 10_000.0), st.sampled_from(SUBSTEPS), st.integers(0, 10**15))
def test_next_substep_is_the_first_that_begins_no_earlier(rate_hz, substeps, instant_ns):
    grid = TickGrid(rate_hz, substeps)
    first = grid.tick_at_or_before(instant_ns) * substeps
    starts = (grid.substep_ns(number) for number in range(first, first + substeps + 1))
    expected_ns = next(start_ns for start_ns in starts if start_ns >= instant_ns)
    assert grid.next_substep_ns(instant_ns) == expected_ns


@given(st.floats(1.0, 10_000.0), st.integers(0, 10**15))
def test_tick_at_or_before_is_the_last_tick_that_has_begun(rate_hz, instant_ns):
    grid = TickGrid(rate_hz, 1)
    tick = grid.tick_at_or_before(instant_ns)
    assert grid.tick_ns(tick) <= instant_ns < grid.tick_ns(tick + 1)


def test_what_is_near_is_waited_for_awake_and_what_is_not_asleep(monkeypatch):
    clock, slept_s = MonotonicClock(awake_ns=2_000_000_000), []
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda span_s: (slept_s.append(span_s), sleep(span_s)))
    near_ns = clock.now_ns() + 1_000_000
    assert clock.wait_until(near_ns) >= 0
    assert clock.now_ns() >= near_ns
    assert slept_s == []
    clock.awake_ns = 0
    assert clock.wait_until(clock.now_ns() + 50_000_000) >= 0
    assert sum(slept_s) > 0.0


@given(st.lists(st.integers(0, 10**12)))
def test_virtual_clock_is_at_the_latest_instant_waited_for_and_starts_at_zero(instants):
    clock = VirtualClock()
    for number, instant in enumerate(instants, start=1):
        assert clock.wait_until(instant) == 0
        assert clock.now_ns() == max(instants[:number])
    clock.start()
    assert clock.now_ns() == 0


def test_monotonic_clock_never_returns_early_and_reports_its_lateness():
    clock = MonotonicClock()
    instant_ns = clock.now_ns() + 100_000
    lateness_ns = clock.wait_until(instant_ns)
    assert lateness_ns >= 0
    assert clock.now_ns() >= instant_ns + lateness_ns
    assert clock.wait_until(0) > instant_ns


def test_start_goes_back_to_the_anchor_and_time_goes_on_until_then():
    clock = MonotonicClock()
    clock.wait_until(1_000_000)
    clock.anchor(HOUR_NS)
    assert clock.now_ns() >= 1_000_000
    anchored_ns = time.monotonic_ns()
    clock.start()
    started_ns = time.monotonic_ns()
    assert clock.now_ns() >= started_ns - anchored_ns + HOUR_NS
    virtual = VirtualClock()
    virtual.wait_until(5)
    virtual.anchor(3)
    assert virtual.now_ns() == 5
    virtual.start()
    assert virtual.now_ns() == 0
