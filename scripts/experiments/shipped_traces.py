"""Makes the shipped traces: minutes of networks with the percentiles that others have published.

They are generated, not measured. `python -m scripts.experiments.shipped_traces` writes them to
``deploy/traces``, with the same numbers on every machine: sums, products and quotients of doubles
and Python's own Mersenne twister are all that is used.

A reflected random walk u has the uniform distribution, and gives the slow waves; with probability
`fresh` a message takes an independent number in its place. The delay is the quantile at that
number, linear between the published percentiles. Losses come in bursts (Gilbert).
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
from pyarrow import parquet

FOLDER = Path(__file__).parents[2] / "deploy" / "traces"
RATE_HZ, DURATION_S = 200, 60
SLOT_S = 15
"""A satellite terminal is given another satellite so often."""


class Network(NamedTuple):
    """A network.

    Attributes:
        quantiles: one-way delays in ms by share, from 0 to 1; a half of published round trips.
        step: largest step of the random walk between two messages.
        fresh: probability that a message has a delay of its own.
        loss: share of messages that are lost.
        burst: mean number of messages lost one after the other.
        is_slotted: the walk starts anew in each slot.
    """

    quantiles: tuple[tuple[float, float], ...]
    step: float
    fresh: float
    loss: float
    burst: float
    is_slotted: bool = False


NETWORKS = {
    "wired_lan": Network(
        ((0.0, 0.05), (0.5, 0.1), (0.9, 0.2), (0.99, 0.45), (1.0, 0.5)), 0.05, 0.8, 0.0, 1.0
    ),
    "wifi_idle": Network(
        ((0.0, 0.5), (0.5, 0.8), (0.9, 1.4), (0.99, 1.5), (1.0, 5.0)), 0.05, 0.7, 0.0005, 1.0
    ),
    "wifi_campus": Network(
        ((0.0, 0.5), (0.5, 1.5), (0.9, 10.0), (0.99, 125.0), (1.0, 150.0)), 0.02, 0.2, 0.005, 2.0
    ),
    "wifi_crowded": Network(
        ((0.0, 1.0), (0.5, 10.0), (0.9, 50.0), (1.0, 125.0)), 0.02, 0.2, 0.02, 3.0
    ),
    "5g": Network(
        ((0.0, 3.5), (0.025, 4.0), (0.5, 7.0), (0.975, 10.0), (1.0, 20.0)), 0.1, 0.8, 0.001, 1.5
    ),
    "satellite": Network(
        ((0.0, 10.0), (0.25, 20.0), (0.5, 25.0), (0.75, 30.0), (1.0, 60.0)), 0.01, 0.1, 0.005, 4.0,
        is_slotted=True,
    ),
    "vpn": Network(
        ((0.0, 11.4), (0.5, 11.6), (0.9, 11.9), (0.99, 13.0), (1.0, 30.0)), 0.02, 0.6, 0.001, 1.0
    ),
}  # fmt: skip


def main() -> None:
    """Write all traces."""
    FOLDER.mkdir(exist_ok=True)
    times_s = [number / RATE_HZ for number in range(RATE_HZ * DURATION_S)]
    for name, network in NETWORKS.items():
        numbers = random.Random(name)
        delays_ms = list(_delays_ms(network, numbers))
        table = pa.table({"time_s": times_s, "delay_ms": pa.array(delays_ms, pa.float32())})
        parquet.write_table(table, FOLDER / f"{name}.parquet", compression="zstd")


def _delays_ms(network: Network, numbers: random.Random) -> Iterator[float | None]:
    """Delays to the microsecond, None for losses."""
    place, is_lost = numbers.random(), False
    leave = 1.0 / network.burst
    fall = leave * network.loss / (1.0 - network.loss)
    for number in range(RATE_HZ * DURATION_S):
        if network.is_slotted and number % (SLOT_S * RATE_HZ) == 0:
            place = numbers.random()
        place = abs(place + network.step * (2.0 * numbers.random() - 1.0))
        place = 1.0 - abs(1.0 - place)
        own = numbers.random()
        share = own if numbers.random() < network.fresh else place
        is_lost = numbers.random() < (1.0 - leave if is_lost else fall)
        yield None if is_lost else round(_quantile(network.quantiles, share), 3)


def _quantile(quantiles: tuple[tuple[float, float], ...], share: float) -> float:
    for (before, low), (after, high) in pairwise(quantiles):
        if share <= after:
            return low + (high - low) * (share - before) / (after - before)
    return quantiles[-1][1]


if __name__ == "__main__":
    main()
