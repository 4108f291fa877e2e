"""Drift of clocks is recognised by the smallest delays; nothing else counts as drift."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.judge.findings.link_delays import MeasuredDelays
from deploy.measure.clocks import drift_ppm, without_drift
from deploy.scenario.referenced_files import TRACES
from plant_emulator.channel.trace_file import LOST_NS, read_trace
from tests.joint_states import joint_state, write_bag


def network(seed: int, seconds: float, rate_hz: float) -> MeasuredDelays:
    """At least 2 ms, mostly 1 to 3 ms more, and 2 % lost."""
    random = np.random.default_rng(seed)
    times_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    delays_ms = 2.0 + random.gamma(2.0, 1.0, len(times_s))
    delays_ms[random.random(len(times_s)) < 0.02] = np.nan
    return MeasuredDelays(times_s, delays_ms)


def with_more(measured: MeasuredDelays, more_ms: np.ndarray) -> MeasuredDelays:
    return measured._replace(delays_ms=measured.delays_ms + more_ms)


@pytest.mark.parametrize("ppm", [-120.0, -8.0, 8.0, 37.0, 450.0])
@pytest.mark.parametrize("seed", range(3))
def test_drift_is_the_slope_that_was_added(ppm: float, seed: int) -> None:
    true = network(seed, 1200.0, 10.0)
    measured = with_more(true, 1e-3 * ppm * true.sent_s)
    found = drift_ppm(measured)
    assert found == pytest.approx(ppm, abs=0.3)
    corrected = without_drift(measured, found).delays_ms
    np.testing.assert_allclose(corrected, true.delays_ms, atol=0.4)


@pytest.mark.parametrize("seed", range(10))
def test_a_network_on_one_clock_drifts_not_at_all(seed: int) -> None:
    assert drift_ppm(network(seed, 300.0, 20.0)) == 0.0


def test_bursts_and_shipped_traces_do_not_drift() -> None:
    true = network(1, 300.0, 20.0)
    burst_ms = np.maximum(0.0, 150.0 - 100.0 * np.abs(true.sent_s - 200.0))
    assert drift_ppm(with_more(true, burst_ms)) == 0.0
    for file in TRACES.glob("*.parquet"):
        trace = read_trace(file)
        delays_ms = np.where(trace.delays_ns == LOST_NS, np.nan, trace.delays_ns / 1e6)
        assert drift_ppm(MeasuredDelays(trace.times_ns / 1e9, delays_ms)) == 0.0, file


@pytest.mark.parametrize(
    ("more_ms", "complaint"),
    [
        (lambda t: 30.0 * (t > 400.0), "move by 30.* ms in 1200 s, and not on a line"),
        (lambda t: 0.04 * np.minimum(t, 600.0), "move by 23.* not on a line"),
        (lambda t: 1000.0 * t, "change by 1000 ms every second, and clocks drift by at most 0.5"),
        (lambda t: 0.8 * t, "or a queue grows"),
    ],
)
def test_what_clocks_do_not_do_is_refused(more_ms, complaint: str) -> None:
    true = network(2, 1200.0, 10.0)
    with pytest.raises(ValueError, match=complaint):
        drift_ppm(with_more(true, more_ms(true.sent_s)))


def write_stamped(file: Path, stamps_ns: list[int], logged_ns: list[int]) -> None:
    states = (joint_state(["elbow"], [0.1], stamp_ns=stamp) for stamp in stamps_ns)
    write_bag(file, (("/joint_states", *row) for row in zip(logged_ns, states, strict=True)))


def test_command_removes_a_drift_and_says_so(tmp_path: Path, funnel_hil) -> None:
    true = network(3, 1200.0, 10.0)
    arrived = np.isfinite(true.delays_ms)
    start_ns = 1_700_000_000_000_000_000
    stamps_ns = [start_ns + round(t * 1e9) for t in true.sent_s[arrived].tolist()]
    logged_ns = [
        stamp + round(1e6 * delay + 37e-6 * (stamp - start_ns))
        for stamp, delay in zip(stamps_ns, true.delays_ms[arrived].tolist(), strict=True)
    ]
    write_stamped(tmp_path / "bag.mcap", stamps_ns, logged_ns)
    words = ("trace", "import", "mcap", tmp_path / "bag.mcap", "--from", "/joint_states")
    words = (*words, "--out", tmp_path / "trace.parquet")
    output = funnel_hil.output(*words)
    assert "the clocks drift by 3" in output
    assert "ppm, 44" in output
    found = read_trace(tmp_path / "trace.parquet").delays_ns / 1e6
    assert np.median(found) == pytest.approx(np.median(true.delays_ms[arrived]), abs=0.1)
    assert "clocks" not in funnel_hil.output(*words, "--one-clock")
    found = read_trace(tmp_path / "trace.parquet").delays_ns / 1e6
    assert np.median(found) > 20.0


def test_stamps_of_simulated_time_are_refused(tmp_path: Path, funnel_hil) -> None:
    stamps_ns = [i * 10_000_000 for i in range(500)]
    logged_ns = [1_700_000_000_004_000_000 + stamp for stamp in stamps_ns]
    write_stamped(tmp_path / "bag.mcap", stamps_ns, logged_ns)
    words = ("trace", "import", "mcap", tmp_path / "bag.mcap", "--from", "/joint_states")
    words = (*words, "--out", tmp_path / "trace.parquet")
    output = funnel_hil.output(*words, code=2)
    assert "bag.mcap: messages are received 1.7e+09 s after they are sent" in output
    assert "two clocks" in output
    assert not (tmp_path / "trace.parquet").exists()
    funnel_hil.output(*words, "--least", "4")  # the user knows
    assert read_trace(tmp_path / "trace.parquet").delays_ns.max() == 4_000_000
    half_speed = [1_700_000_000_000_000_000 + 2 * stamp for stamp in stamps_ns]
    write_stamped(tmp_path / "bag.mcap", stamps_ns, half_speed)
    output = funnel_hil.output(*words, "--least", "4", code=2)
    assert "one clock shows simulated time" in output
