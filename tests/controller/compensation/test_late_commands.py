"""How long commands are waited for after some came late: exceptions, and episodes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controller.compensation.command_timeline import (
    CommandFeedback,
    HorizonSettings,
    forget_commands,
    no_commands,
    note,
    observe,
)

MS = 1_000_000
USUAL_MS, MOST_MS = 20, 60
SETTINGS = HorizonSettings(
    first_ns=USUAL_MS * MS, wanted_ns=USUAL_MS * MS, most_ns=MOST_MS * MS,
    is_announced=True, reserve_ns=MS,
)  # fmt: skip


def horizons_ms(arrivals_ms) -> np.ndarray:
    """The horizon after each state, of which each reports the arrival of one command."""
    commands, horizons = no_commands(1, SETTINGS), []
    forget_commands(commands)
    note(commands, np.zeros(1), np.zeros((2, 1)), 1, 0)
    for tick, arrival_ms in enumerate(arrivals_ms, start=1000):
        feedback = CommandFeedback(1, USUAL_MS * MS, int(arrival_ms * MS))
        observe(commands, feedback, tick * MS, (tick - 1) * MS)
        horizons.append(1e-6 * float(commands.state["horizon_ns"][0]))
    return np.array(horizons)


def test_a_burst_that_arrives_at_one_instant_is_waited_for_no_longer_than_the_limit():
    """All of its commands are reported at once, the later ones arrive in time: no outage of d."""
    found = horizons_ms([5] * 10 + [300] + [5] * 100)
    assert found[9] == USUAL_MS
    assert found[10:].max() == MOST_MS


def test_late_commands_below_the_limit_are_waited_for_at_once():
    assert horizons_ms([5, 40])[-1] == 41


def test_commands_that_come_late_for_long_are_waited_for():
    found = horizons_ms([5] + [150] * 40)
    assert found[20] == MOST_MS
    assert found[21] == 151  # 20 ms after the first


def test_one_command_in_time_ends_an_episode():
    assert horizons_ms(([150] * 15 + [5]) * 10).max() == MOST_MS


def test_after_an_episode_the_horizon_returns_to_its_limit():
    """By the factor e in half a second, towards what commands take."""
    found = horizons_ms([150] * 30 + [5] * 1000)
    after_s = 0.2
    expected = 5 + (151 - 5) * math.exp(-after_s / 0.5)
    assert found[29 + 200] == pytest.approx(expected, rel=0.05)
    assert found[-1] <= MOST_MS
