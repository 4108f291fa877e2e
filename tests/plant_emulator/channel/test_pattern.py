"""Delays in a pattern are a function of the run's time, between the smallest and the largest."""

from __future__ import annotations

import numpy as np
import pytest

from bus_schema.link.channel_configuration import PatternConfiguration
from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.channel import NEVER_NS
from plant_emulator.channel.delay_range import configured_delays_ns
from plant_emulator.channel.opening import open_uplink
from plant_emulator.channel.pattern import delay_in_pattern_ns

MS = 1_000_000


def shape(times_ms, largest_ms=10.0, **pattern):
    """Delays in ms at these times."""
    given = PatternConfiguration(**pattern)
    return [1e-6 * delay_in_pattern_ns(given, largest_ms * MS, round(t * MS)) for t in times_ms]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ({"shape": "square"}, [0, 0, 10, 10, 0]),
        ({"shape": "square", "duty": 0.25}, [0, 0, 0, 10, 0]),
        ({"shape": "square", "phase_ms": 2}, [10, 10, 0, 0, 10]),
        ({"shape": "square", "least_ms": 3}, [3, 3, 10, 10, 3]),
        ({"shape": "square", "least_ms": 30}, [10, 10, 10, 10, 10]),  # never above the largest
        ({"shape": "sawtooth"}, [0, 2.5, 5, 7.5, 0]),
        ({"shape": "sawtooth", "least_ms": 2}, [2, 4, 6, 8, 2]),
        ({"shape": "falling"}, [10, 7.5, 5, 2.5, 10]),
    ],
)
def test_shapes(pattern, expected):
    assert shape(range(5), period_ms=4, **pattern) == pytest.approx(expected)


def test_random_delays_are_constant_within_a_period_and_independent_of_each_other():
    pattern = {"shape": "random", "period_ms": 4}
    delays = np.array(shape(range(40_000), **pattern)).reshape(-1, 4)
    assert (delays == delays[:, :1]).all()
    each = delays[:, 0]
    # Uniform from 0 to 10: mean 5, deviation 10/√12; 10,000 draws agree to 4 standard errors.
    assert each.mean() == pytest.approx(5, abs=4 * 2.89 / 100)
    assert each.std() == pytest.approx(10 / np.sqrt(12), abs=0.1)
    assert abs(np.corrcoef(each[1:], each[:-1])[0, 1]) < 0.04
    assert shape([17], **pattern) == [each[4]]  # with any earlier request
    assert shape([17], seed=2, **pattern) != [each[4]]


def test_a_walk_is_linear_between_the_random_delays():
    corners = shape([0, 4, 8], shape="random", period_ms=4)
    walk = shape(range(9), shape="walk", period_ms=4)
    assert walk == pytest.approx(np.interp(range(9), [0, 4, 8], corners))


def test_messages_stay_in_order_unless_they_may_overtake():
    """8 ms for five messages, then 0: these wait for the others, or overtake them."""
    uplink = {"delay_ms": 8, "pattern": {"shape": "square", "period_ms": 10, "phase_ms": 5}}
    out = {}
    for reorder in (False, True):
        channel = open_uplink(LinkConfiguration(uplink={**uplink, "reorder": reorder}), 1)
        for number in range(10):
            channel.send(number, number * MS, 100)
        out[reorder] = [(due_ns / MS, number) for due_ns, number in channel.take_due(NEVER_NS - 1)]
    late = [(8 + number, number) for number in range(5)]
    assert out[False] == late + [(12, number) for number in range(5, 10)]
    assert out[True] == sorted(late + [(number, number) for number in range(5, 10)])


def test_a_ramp_shapes_what_it_grows_to():
    schedule = [{"kind": "step", "at_s": 0.004, "delay_ms": 20}]
    pattern = {"shape": "square", "period_ms": 4, "phase_ms": 2}
    link = LinkConfiguration(uplink={"delay_ms": 10, "pattern": pattern, "schedule": schedule})
    channel = open_uplink(link, 1)
    for number in range(8):
        channel.send(number, number * MS, 100)
    due = {number: due_ns / MS for due_ns, number in channel.take_due(NEVER_NS - 1)}
    assert [due[number] for number in (0, 1, 4, 5)] == [10, 11, 24 + 0, 25 + 0]


def test_the_largest_delay_is_what_controller_and_deadline_expect():
    """So the horizon of automatic play-out is that of the constant delay."""
    pattern = {"shape": "sawtooth", "period_ms": 4}
    link = LinkConfiguration(uplink={"delay_ms": 10, "pattern": pattern})
    assert not link.uplink.is_constant
    assert set(configured_delays_ns(link.uplink)) == {10 * MS}
    assert open_uplink(link, 1).mean_delay_ns == 10 * MS


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ({"shape": "sawtooth", "period_ms": 4, "duty": 0.2}, "without duty unless shape"),
        ({"shape": "square", "period_ms": 4, "seed": 2}, "without seed unless shape"),
        ({"shape": "square", "period_ms": 0}, "greater than or equal to 0.001"),
        ({"shape": "square", "period_ms": 4, "duty": 1}, "less than 1"),
        ({"shape": "triangle", "period_ms": 4}, "'square'"),
    ],
)
def test_values_without_effect_are_refused(pattern, message):
    with pytest.raises(ValueError, match=message):
        PatternConfiguration(**pattern)
