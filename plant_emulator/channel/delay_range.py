"""Which delays a direction of the link is configured to have, before any message is sent."""

from __future__ import annotations

from pathlib import Path
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from bus_schema.link.channel_configuration import ChangeableConditions, ChannelConfiguration
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
    if is_random or any(stage.jitter_ms or stage.rate_kbit_s for stage in _stages(configuration)):
        return None
    return int(configured_delays_ns(configuration)[-1])


def _stages(
    configuration: ChannelConfiguration,
) -> list[ChannelConfiguration | ChangeableConditions]:
    """Return a direction's conditions at the start, and after each change of its schedule."""
    changes = (each for each in configuration.schedule if isinstance(each, ChangeableConditions))
    return [configuration, *changes]


def round_trip_ns(up_ns: NDArray[np.int64], down_ns: NDArray[np.int64], share: float) -> int:
    """Return the round trip that this share of messages does not exceed, ns.

    Args:
        up_ns: equally likely delays of states.
        down_ns: those of commands, independent of them.
        share: from 0 to 1.
    """
    sums = np.sort(np.add.outer(up_ns, down_ns).ravel())
    return int(sums[min(int(share * len(sums)), len(sums) - 1)])
