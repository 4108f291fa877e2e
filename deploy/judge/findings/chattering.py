"""Chattering: variation of torque that is too fast for anything but the switching of a law.

Power spectra after Welch: Hann-windowed segments of one second that overlap by half, averaged.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bus_schema.arrays import Matrix, Vector
from deploy.judge.recorded_ticks import NO_ROWS, Rows

CHATTER_HZ = 50.0
"""Torque counts as chatter from this frequency up; an arm's motions are far slower."""

_SEGMENT_S = 1.0


def power_spectrum(
    torques_nm: Matrix, rate_hz: float, after_gaps: Rows = NO_ROWS
) -> tuple[Vector, Matrix]:
    """Return the power of each joint's torque by frequency, with its mean removed.

    Args:
        torques_nm: evenly spaced in time, shape (samples, joints), at least 2 samples.
        rate_hz: samples per second.
        after_gaps: samples that follow a gap, which no segment may span.

    Returns:
        Frequencies in Hz, shape (frequencies,), and N² m² at each, shape (frequencies, joints).
    """
    stretches = np.split(torques_nm - torques_nm.mean(axis=0), after_gaps)
    length = min(max(map(len, stretches)), max(2, round(_SEGMENT_S * rate_hz)))
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(length) + 0.5) / length)
    segments = np.concatenate([
        sliding_window_view(stretch, length, axis=0)[:: max(1, length // 2)]
        for stretch in stretches
        if len(stretch) >= length
    ])  # fmt: skip
    spectra = np.fft.rfft(window * segments)
    power = (spectra.real**2 + spectra.imag**2).mean(axis=0).T
    bins = np.arange(len(power))  # each stands for two, except at both ends
    sides = np.where((bins == 0) | (2 * bins == length), 1.0, 2.0)
    scale = sides[:, None] / (length * np.sum(window**2))
    frequencies = np.asarray(bins * (rate_hz / length), dtype=np.float64)
    return frequencies, np.asarray(scale * power)


def chatter_shares(
    torques_nm: Matrix, rate_hz: float, after_gaps: Rows = NO_ROWS
) -> list[float] | None:
    """Return each joint's share of varying torque energy above `CHATTER_HZ`; 0 if it is constant.

    Args:
        torques_nm: evenly spaced in time, shape (samples, joints).
        rate_hz: samples per second; at twice `CHATTER_HZ` or below, the result is None.
        after_gaps: as for `power_spectrum`.
    """
    if rate_hz <= 2.0 * CHATTER_HZ or len(torques_nm) < 2:
        return None
    frequencies, power = power_spectrum(torques_nm, rate_hz, after_gaps)
    total, fast = power.sum(axis=0), power[frequencies > CHATTER_HZ].sum(axis=0)
    shares: list[float] = np.divide(fast, total, out=np.zeros_like(fast), where=total > 0).tolist()
    return shares
