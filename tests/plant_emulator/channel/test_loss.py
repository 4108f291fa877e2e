"""Losses meet their definition, within four standard errors at a fixed seed."""

import math

import numpy as np
import pytest

from bus_schema.link.channel_configuration import ChannelConfiguration
from plant_emulator.channel.conditions import ConditionsSchedule
from plant_emulator.channel.impairment import Loss

MESSAGES = 60_000


def losses(seed=3, **channel):
    """Whether each message is lost, shape (messages,)."""
    conditions = ConditionsSchedule(ChannelConfiguration(**channel)).at(0)
    loss = Loss(np.random.default_rng(seed), np.random.default_rng(seed + 1000))
    return np.array([loss.loses_next(conditions) for _ in range(MESSAGES)])


def bursts(lost):
    """Lengths of the runs of losses."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], lost.astype(int), [0]))))
    return edges[1::2] - edges[::2]


def test_random_loss_has_its_rate_and_no_memory():
    lost = losses(loss=0.1)
    assert lost.mean() == pytest.approx(0.1, abs=4 * math.sqrt(0.09 / MESSAGES))
    lengths = bursts(lost)  # geometric: mean 1 / 0.9, variance 0.1 / 0.9²
    error = math.sqrt(0.1) / 0.9 / math.sqrt(len(lengths))
    assert lengths.mean() == pytest.approx(1 / 0.9, abs=4 * error)


@pytest.mark.parametrize(
    ("given", "mean_loss"),
    [
        ({"p": 0.02, "r": 0.25}, 0.02 / 0.27),
        ({"p": 0.02, "r": 0.25, "loss_in_bad": 0.6}, 0.02 / 0.27 * 0.6),
        (
            {"p": 0.1, "r": 0.3, "loss_in_bad": 0.5, "loss_in_good": 0.05},
            (0.1 * 0.5 + 0.3 * 0.05) / 0.4,
        ),
        ({"mean_loss": 0.02, "mean_burst": 3}, 0.02),
    ],
    ids=["gilbert", "1-h", "1-k", "means"],
)
def test_burst_loss_has_its_mean(given, mean_loss):
    found = losses(burst_loss=given).mean()
    # Correlation of the state over k messages is (1 − p − r)^k, so the variance of a mean grows by
    # (2 − p − r) / (p + r) at most.
    configuration = ChannelConfiguration(burst_loss=given).burst_loss
    p, r, _, _ = configuration.chain
    variance = mean_loss * (1 - mean_loss) * (2 - p - r) / (p + r)
    assert found == pytest.approx(mean_loss, abs=4 * math.sqrt(variance / MESSAGES))


@pytest.mark.parametrize(
    ("given", "mean_burst"),
    [({"p": 0.02, "r": 0.25}, 4.0), ({"mean_loss": 0.02, "mean_burst": 3}, 3.0)],
)
def test_bursts_are_geometric_with_their_mean(given, mean_burst):
    lengths = bursts(losses(burst_loss=given))
    deviation = math.sqrt(mean_burst * (mean_burst - 1))
    assert lengths.mean() == pytest.approx(mean_burst, abs=4 * deviation / math.sqrt(len(lengths)))
    single = 1 / mean_burst
    error = math.sqrt(single * (1 - single) / len(lengths))
    assert np.mean(lengths == 1) == pytest.approx(single, abs=4 * error)


def test_kinds_of_loss_do_not_disturb_each_other():
    random, burst = losses(loss=0.1), losses(burst_loss={"p": 0.02, "r": 0.25})
    both = losses(loss=0.1, burst_loss={"p": 0.02, "r": 0.25})
    assert np.array_equal(both, random | burst)


@pytest.mark.parametrize(("loss", "expected"), [(0.0, 0), (1.0, MESSAGES)])
def test_nothing_and_everything_are_exact(loss, expected):
    assert losses(loss=loss).sum() == expected
