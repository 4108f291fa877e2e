"""Replays a trace in time order, and compares a channel's delays with it."""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.link.channel_configuration import TraceConfiguration
from plant_emulator.channel.trace_file import LOST_NS, read_trace

PERCENTS = (0, 1, 5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 98, 99, 99.5, 99.9, 100)
_LONGEST_LAG_S = 1.0
_MOST_LAGS = 40
_MOST_SAMPLES = 100_000


class TraceReplay:
    """Returns the trace's delay for a message sent at an instant; instants must not decrease.

    Args:
        configuration: section ``trace`` of a direction.
        random: where the start is drawn from, if none is given.

    Raises:
        ValueError: its file cannot be used.

    Attributes:
        mean_delay_ns: mean of what it gives, but for losses.
        is_second_half: set it where commands get the half of a round trip that belongs to the state
            that they answer.
    """

    def __init__(self, configuration: TraceConfiguration, random: np.random.Generator) -> None:
        self.trace = trace = read_trace(Path(configuration.file))
        self._configuration, self.is_second_half = configuration, False
        self._offset_ns, self._scale = round(configuration.offset_ms * 1e6), configuration.scale
        self._is_linear = configuration.interpolation == "linear"
        self._times, self._delays = trace.times_ns.data, trace.delays_ns.data
        first, last = trace.seam
        self._first_ns, self._seam_ns = self._times[first], self._times[last] + trace.gap_ns
        if configuration.start_s is None:
            span_ns = self._seam_ns - self._first_ns
            self._shift_ns = self._first_ns + int(random.random() * span_ns)
        else:
            self._shift_ns = round(configuration.start_s * 1e9)
        # What lies beyond the seam plays where the start is there, and without repetition.
        plays_end = not configuration.loop or self._shift_ns >= self._seam_ns
        self._end_ns = trace.length_ns if plays_end else self._seam_ns
        self._index, self._next_ns = -1, -1
        self._held: int | None = None
        self.mean_delay_ns = self._offset_ns + round(self._scale * trace.mean_delay_ns)

    def delay_ns(self, now_ns: int, item: object = None) -> int | None:
        """Return the delay of a message that is sent now, not yet cut off at zero; None if lost."""
        if self.is_second_half:
            now_ns = min(now_ns, getattr(item, "stamp_ns", now_ns))
        place_ns = now_ns + self._shift_ns
        if place_ns < self._next_ns:
            return self._held if not self._is_linear else self._between(place_ns)
        while place_ns >= self._end_ns and self._configuration.loop:
            self._shift_ns -= self._end_ns - self._first_ns
            place_ns = now_ns + self._shift_ns
            self._end_ns, self._index = self._seam_ns, -1
        times = self._times
        self._index = index = bisect_right(times, place_ns, max(self._index, 0)) - 1
        following = times[index + 1] if index + 1 < len(times) else self._end_ns
        self._next_ns = min(following, self._end_ns)
        delay_ns = self._delays[index]
        self._held = None if delay_ns < 0 else self._offset_ns + round(self._scale * delay_ns)
        return self._held if not self._is_linear else self._between(place_ns)

    def _between(self, place_ns: int) -> int | None:
        """Interpolate linearly to the next message, if both arrived."""
        index, times, delays = self._index, self._times, self._delays
        if self._held is None or index + 1 >= len(times) or delays[index + 1] < 0:
            return self._held
        share = (place_ns - times[index]) / (times[index + 1] - times[index])
        rise_ns = delays[index + 1] - delays[index]
        return self._held + round(self._scale * share * rise_ns)

    def sampled(self, period_ns: int) -> NDArray[np.int64]:
        """Return the delays of the whole trace for messages with this period, `LOST_NS` if lost."""
        times_ns, given_ns = self.trace.times_ns, self.trace.delays_ns
        count = min(self.trace.length_ns // period_ns, _MOST_SAMPLES)
        places_ns = np.arange(count, dtype=np.int64) * period_ns
        before = np.searchsorted(times_ns, places_ns, side="right") - 1
        after = np.minimum(before + 1, len(times_ns) - 1)
        held_ns = self._offset_ns + np.rint(self._scale * given_ns[before])
        if self._is_linear:
            apart_ns = np.maximum(times_ns[after] - times_ns[before], 1)
            share = (places_ns - times_ns[before]) / apart_ns
            rise_ns = np.rint(self._scale * share * (given_ns[after] - given_ns[before]))
            held_ns += np.where(given_ns[after] < 0, 0.0, rise_ns)
        return np.where(given_ns[before] < 0, LOST_NS, np.maximum(0, held_ns)).astype(np.int64)


def curves(delays_ns: NDArray[np.int64], period_s: float) -> dict[str, Any]:
    """Percentiles (of `PERCENTS`) and autocorrelation of delays up to 1 s, for comparison.

    Args:
        delays_ns: of messages in the order of sending, `LOST_NS` for losses; shape (messages,).
        period_s: between two messages.

    Returns:
        ``percentiles_ms``, ``lags_s`` and ``autocorrelation``; empty where nothing arrived, the
        latter also where all delays are equal.
    """
    arrived = delays_ns >= 0
    if not arrived.any():
        return {"percentiles_ms": [], "lags_s": [], "autocorrelation": []}
    ordered = np.sort(delays_ns[arrived])
    places = [round(percent / 100.0 * (len(ordered) - 1)) for percent in PERCENTS]
    about_mean = np.where(arrived, delays_ns / 1e6 - float(ordered.mean()) / 1e6, 0.0)
    variance = float((about_mean**2).sum()) / len(ordered)
    longest = min(max(1, round(_LONGEST_LAG_S / period_s)), len(delays_ns) - 1)
    lags = sorted({round(longest ** (step / _MOST_LAGS)) for step in range(_MOST_LAGS + 1)})
    found = {}
    for lag in lags if variance > 0.0 else ():
        pairs = int((arrived[lag:] & arrived[:-lag]).sum())
        if pairs:
            product = float((about_mean[lag:] * about_mean[:-lag]).sum())
            found[round(lag * period_s, 6)] = round(product / pairs / variance, 6)
    return {
        "percentiles_ms": [round(float(ordered[place]) / 1e6, 6) for place in places],
        "lags_s": list(found),
        "autocorrelation": list(found.values()),
    }
