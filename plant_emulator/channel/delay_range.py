"""Range of the delays that a direction of the link is configured to have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from bus_schema.link.channel_configuration import ChannelConfiguration, Outage, Ramp, Step
from plant_emulator.channel.jitter import quantile_of
from plant_emulator.channel.trace_file import read_trace

_SAMPLES = 400
_SHARES = (np.arange(_SAMPLES) + 0.5) / _SAMPLES


def configured_delays_ns(configuration: ChannelConfiguration) -> NDArray[np.int64]:
    """Return equally likely delays of a direction, ascending; shape (samples,).

    Of a schedule, the largest values count. Queues of a limited bandwidth do not.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    stages = _stages(configuration)
    delay_ms, jitter_ms = (
        max(getattr(stage, key) or 0.0 for stage in stages) for key in ("delay_ms", "jitter_ms")
    )
    if configuration.distribution == "empirical":
        jitter_ms = 1.0  # its draws are delays in ms
    delays_ns = np.full(_SAMPLES, round(delay_ms * 1e6))
    if jitter_ms:
        quantile, normal = quantile_of(configuration)[0], NormalDist()
        draws = [quantile(normal.inv_cdf(share)) for share in _SHARES.tolist()]
        delays_ns += np.rint(1e6 * jitter_ms * np.array(draws)).astype(np.int64)
    if configuration.trace is not None:
        trace = read_trace(Path(configuration.trace.file))
        arrived = np.sort(trace.delays_ns[trace.delays_ns >= 0])
        picked = arrived[(_SHARES * len(arrived)).astype(np.int64)]
        picked[-1] = arrived[-1]
        offset_ns = round(configuration.trace.offset_ms * 1e6)
        delays_ns += offset_ns + np.rint(configuration.trace.scale * picked).astype(np.int64)
    return delays_ns.clip(0)


def largest_delay_ns(configuration: ChannelConfiguration) -> int | None:
    """Return the delay that no message of a direction exceeds, ns; None if there is none.

    Jitter and a limited bandwidth have no such limit, or none that is known.

    Args:
        configuration: a section ``link.uplink`` or ``link.downlink``.

    Raises:
        ValueError: its file of delays cannot be used.
    """
    is_random = configuration.distribution == "empirical"
    stages = _stages(configuration)
    if is_random or any(stage.jitter_ms or stage.rate_kbit_s for stage in stages):
        return None
    return int(configured_delays_ns(configuration)[-1])


def loses(configuration: ChannelConfiguration) -> bool:
    """Whether a direction loses messages at any time."""
    return loses_in_a_row(configuration) or any(each.loss for each in _stages(configuration))


def loses_in_a_row(configuration: ChannelConfiguration) -> bool:
    """Whether a direction has bursts of loss or outages."""
    has_outage = any(isinstance(each, Outage) for each in configuration.schedule)
    return has_outage or any(each.burst_loss is not None for each in _stages(configuration))


def _stages(configuration: ChannelConfiguration) -> list[ChannelConfiguration | Step | Ramp]:
    """Return a direction's conditions at the start, and after each change of its schedule."""
    changes = (each for each in configuration.schedule if isinstance(each, Step | Ramp))
    return [configuration, *changes]


def spare_at_start_ns(sides: Sequence[ChannelConfiguration], growth: float) -> int:
    """Return by how much a round trip that grows with time may be below the longest at first, ns.

    It is then never below the one that the schedules of the directions have reached.

    Args:
        sides: sections ``link.uplink`` and ``link.downlink``.
        growth: what it grows by, as a share of the time.
    """
    stages = [_stages(side) for side in sides]
    ends_s = {_span_s(stage)[1] for side in stages for stage in side}
    needed_ms = max(
        sum(_delay_at_ms(side, end_s) for side in stages) - 1e3 * growth * end_s for end_s in ends_s
    )
    longest_ms = sum(max(stage.delay_ms or 0.0 for stage in side) for side in stages)
    return round(1e6 * (longest_ms - needed_ms))


def _delay_at_ms(stages: list[ChannelConfiguration | Step | Ramp], time_s: float) -> float:
    """Return a direction's constant delay at a time, and the longer one during a ramp."""
    delay_ms = 0.0
    for stage in stages:
        begin_s, end_s = _span_s(stage)
        if begin_s <= time_s and stage.delay_ms is not None:
            delay_ms = stage.delay_ms if end_s <= time_s else max(delay_ms, stage.delay_ms)
    return delay_ms


def _span_s(stage: ChannelConfiguration | Step | Ramp) -> tuple[float, float]:
    """Return when conditions begin to change, and when they have changed."""
    return (0.0, 0.0) if isinstance(stage, ChannelConfiguration) else (stage.at_s, stage.end_s)


def round_trip_ns(up_ns: NDArray[np.int64], down_ns: NDArray[np.int64], share: float) -> int:
    """Return the round trip that this share of messages does not exceed, ns.

    Args:
        up_ns: equally likely delays of states.
        down_ns: those of commands, independent of them.
        share: from 0 to 1.
    """
    sums = np.sort(np.add.outer(up_ns, down_ns).ravel())
    return int(sums[min(int(share * len(sums)), len(sums) - 1)])
