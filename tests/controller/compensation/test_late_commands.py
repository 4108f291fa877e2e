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


def horizons_ms(reports_ms) -> np.ndarray:
    """The horizon after each state, which reports how late the commands since the last came.

    A report is the time that a command took to arrive, and to come into force; or both, where only
    the first of several that arrive at one instant came late.
    """
    commands, horizons = no_commands(1, SETTINGS), []
    forget_commands(commands)
    for number in (1, 2):
        note(commands, np.zeros(1), np.zeros((2, 1)), number, 0)
    for tick, report_ms in enumerate(reports_ms, start=1000):
        arrival_ms, in_force_ms = report_ms if isinstance(report_ms, tuple) else 2 * (report_ms,)
        in_force_ns = int(max(in_force_ms, USUAL_MS) * MS)
        feedback = CommandFeedback(1 + tick % 2, in_force_ns, int(arrival_ms * MS))
        observe(commands, feedback, tick * MS, (tick - 1) * MS)
        horizons.append(1e-6 * float(commands.state["horizon_ns"][0]))
    return np.array(horizons)


def test_a_burst_that_arrives_at_one_instant_stretches_the_horizon_by_one_tick():
    """All of its commands are reported at once, and the newest is in time: nothing is late now."""
    found = horizons_ms([5] * 10 + [(300, 5)] + [5] * 100)
    assert found[9] == USUAL_MS
    assert found[10:].max() == USUAL_MS + 1


def test_late_commands_below_the_limit_are_waited_for_at_once():
    assert horizons_ms([5, 40])[-1] == 41
    assert horizons_ms([5, 300])[-1] == MOST_MS


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
