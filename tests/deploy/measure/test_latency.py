"""Known dead times and lags are recovered, and motions that do not tell them are refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from deploy.measure.latency import find_latency


def recorded(
    rate_hz: float, dead_ms: float, lag_ms: float, noise: float, *, feedback: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, held commands and noisy responses of a system with gain 0.9, in steps of 0.1 ms."""
    random, step_s = np.random.default_rng(5), 1e-4
    every, dead = round(1.0 / rate_hz / step_s), round(dead_ms * 1e-3 / step_s)
    decay = 1.0 - math.exp(-step_s / (lag_ms * 1e-3))
    rows = round(20.0 * rate_hz)
    wanted = np.repeat(random.standard_normal(rows // 8 + 1), 8)[:rows]  # steps of eight rows
    held = np.zeros(dead + rows * every + 1)
    state, commands, responses = 0.0, [], []
    for row in range(rows):
        responses.append(state + 0.1 + noise * random.standard_normal())
        commands.append(wanted[row] - feedback * responses[-1])
        held[dead + row * every : dead + (row + 1) * every] = commands[-1]
        for k in range(row * every, (row + 1) * every):
            state += decay * (0.9 * held[k] - state)
    times_s = np.arange(rows) * every * step_s
    return times_s, np.array(commands), np.array(responses)


@pytest.mark.parametrize("rate_hz", [30.0, 100.0, 1000.0])
@pytest.mark.parametrize(("dead_ms", "lag_ms"), [(4.0, 20.0), (35.0, 60.0), (80.0, 15.0)])
@pytest.mark.parametrize("feedback", [0.0, 0.3])
def test_known_system_is_recovered(
    rate_hz: float, dead_ms: float, lag_ms: float, feedback: float
) -> None:
    noise = 0.002
    rows = recorded(rate_hz, dead_ms, lag_ms, noise, feedback=feedback)
    found = find_latency(*rows, 0.3, is_held=True)
    assert 1e3 * found.dead_time_s[0] == pytest.approx(dead_ms, abs=0.5)
    assert 1e3 * found.lag_s[0] == pytest.approx(lag_ms, rel=0.1)
    assert found.gain[0] == pytest.approx(0.9, rel=0.02)
    assert 1e3 * found.dead_time_s[1] < 0.5


def test_intervals_grow_with_noise() -> None:
    halves = [
        find_latency(*recorded(200.0, 20.0, 30.0, noise), 0.3, is_held=True).dead_time_s[1]
        for noise in (0.001, 0.01, 0.1)
    ]
    assert halves == sorted(halves)
    assert halves[2] > 20 * halves[0]


def test_one_sine_does_not_tell_dead_time_from_lag() -> None:
    times_s = np.arange(0.0, 20.0, 0.01)
    random = np.random.default_rng(1)
    response = np.sin(3.0 * (times_s - 0.05)) + 0.01 * random.standard_normal(len(times_s))
    with pytest.raises(ValueError, match="separate dead time and lag; together they are"):
        find_latency(times_s, np.sin(3.0 * times_s), response, 0.3, is_held=False)


@pytest.mark.parametrize(
    ("command", "response", "complaint"),
    [
        (np.zeros(2000), np.arange(2000.0), "never changes"),
        (np.random.default_rng(1).random(2000), np.random.default_rng(2).random(2000), "explain"),
    ],
)
def test_what_says_nothing_is_refused(command, response, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        find_latency(np.arange(2000) * 0.01, command, response, 0.3, is_held=True)


def test_command_reads_lists_and_takes_the_longest_episode(tmp_path: Path, funnel_hil) -> None:
    times_s, command, response = recorded(100.0, 20.0, 30.0, 0.001)
    again = np.concatenate([times_s[:300], times_s])
    table = {
        "timestamp": again,
        "action": np.column_stack([np.zeros(len(again)), [*command[:300], *command]]).tolist(),
        "observation.state": [[each] for each in [*response[:300], *response]],
    }
    file = tmp_path / "episodes.parquet"
    parquet.write_table(pa.table(table), file)
    words = ("latency", file, "--time", "timestamp", "--response", "observation.state[0]")
    code, said = funnel_hil(*words, "--command", "action[1]")
    assert code == 0, said
    assert "2,000 rows at 100 Hz (the longest of 2 episodes)" in said
    assert "dead time: 2" in said or "dead time: 19.9" in said
    code, said = funnel_hil(*words, "--command", "actoin[1]")
    assert code == 2
    assert "did you mean action" in said
    code, said = funnel_hil(*words, "--command", "action[0]")
    assert code == 2
    assert "never changes" in said
