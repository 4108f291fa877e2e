"""Chattering: how much of a torque's variation is too fast for anything but the switching of a law.

Power spectra after Welch: Hann-windowed segments of one second that overlap by half, averaged.
"""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector

CHATTER_HZ = 50.0
"""From here on up, torque is chatter; the motions asked of an arm are far slower."""

_SEGMENT_S = 1.0


def power_spectrum(torques_nm: Matrix, rate_hz: float) -> tuple[Vector, Matrix]:
    """Power of each joint's torque by frequency, its mean removed.

    Args:
        torques_nm: evenly spaced in time, shape (samples, joints), at least 2 samples.
        rate_hz: samples per second.

    Returns:
        Frequencies in Hz, shape (frequencies,), and N² m² at each, shape (frequencies, joints).
    """
    samples = len(torques_nm)
    length = min(samples, max(2, round(_SEGMENT_S * rate_hz)))
    varying = torques_nm - torques_nm.mean(axis=0)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(length) + 0.5) / length)
    starts = range(0, samples - length + 1, max(1, length // 2))
    power = np.mean(
        [
            np.abs(np.fft.rfft(window[:, None] * varying[start : start + length], axis=0)) ** 2
            for start in starts
        ],
        axis=0,
    )
    both_sides = np.full(len(power), 2.0)
    both_sides[0] = 1.0
    if length % 2 == 0:
        both_sides[-1] = 1.0
    scale = both_sides[:, None] / (length * np.sum(window**2))
    frequencies = np.arange(len(power)) * (rate_hz / length)
    return np.asarray(frequencies, dtype=np.float64), np.asarray(scale * power)


def chatter_shares(torques_nm: Matrix, rate_hz: float) -> list[float] | None:
    """Share of each joint's varying torque energy above `CHATTER_HZ`; 0 for a constant torque.

    Args:
        torques_nm: evenly spaced in time, shape (samples, joints).
        rate_hz: samples per second; at twice `CHATTER_HZ` or below there is nothing to tell: None.
    """
    if rate_hz <= 2.0 * CHATTER_HZ or len(torques_nm) < 2:
        return None
    frequencies, power = power_spectrum(torques_nm, rate_hz)
    total, fast = power.sum(axis=0), power[frequencies > CHATTER_HZ].sum(axis=0)
    shares: list[float] = np.divide(fast, total, out=np.zeros_like(fast), where=total > 0).tolist()
    return shares
