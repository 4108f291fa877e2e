"""From a log to even samples without noise: checks, gaps, filters without phase, accelerations."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from deploy.measure.identify.robot_log import FEWEST_ROWS, SHORTEST_S, RobotLog

_SLOW_RAD_S, _FULL_TURNS_RAD = 0.05, 4.0 * math.pi
_LARGEST, _MOST_DAMAGED = 1e6, 0.01
_GAP_PERIODS, _SHORT_GAP, _MOST_HZ = 6.0, 0.25, 1000.0
_POWER, _ABOVE, _CUTOFFS_HZ = 0.999, 10.0, (3.0, 8.0)
_PER_CUTOFF, _LIGHT = 25.0, 2.0
_SLOWER_HZ = 20.0
_LONGEST_PERIOD_S = 0.1
_PATTERN, _JUMP = 41, 3.5
_AROUND, _FAR_S = 9, 1.0
"""Rows around a row, an odd number, from whose times its own is farther only if it is damaged."""


@dataclass(frozen=True)
class Samples:
    """Even samples of a motion, filtered; joints in the order of the robot's file.

    Attributes:
        name: of the file.
        times_s: shape (samples,).
        is_known: whether there are rows of the log near a sample, shape (samples,).
        position: shape (samples, joints), as the next two with twice the cutoff.
        velocity: rad/s.
        acceleration: rad/s².
        torque: same shape, with the cutoff; N m or A.
        torque_rate: its derivative.
        cutoff_hz: frequency at which the filter's gain is 0.7.
        notes: what was changed in the log, a sentence each.
    """

    name: str
    times_s: Vector
    is_known: NDArray[np.bool_]
    position: Matrix
    velocity: Matrix
    acceleration: Matrix
    torque: Matrix
    torque_rate: Matrix
    cutoff_hz: float
    notes: tuple[str, ...] = ()

    @property
    def rate_hz(self) -> float:
        return float(1.0 / (self.times_s[1] - self.times_s[0]))


def checked(log: RobotLog, robot: RobotDescription) -> tuple[RobotLog, list[str]]:
    """Return a log without damaged and doubled rows, and notes about them.

    Raises:
        InputError: too much is damaged, or the values cannot be what they should be.
    """
    keep, notes = _undamaged(log), list[str]()
    if not keep.all():
        first = int(np.argmin(keep))
        many, named = int((~keep).sum()), f"{log.path.name}, {log.place(first)}"
        if many > max(3.0, _MOST_DAMAGED * keep.size):
            raise log.refusal(
                f"{many} of {keep.size} rows have values that are missing or impossible; at most"
                f" {100 * _MOST_DAMAGED:g} % may", first,
            )  # fmt: skip
        notes.append(f"{many} damaged rows are left out, the first is {named}")
    rows = np.flatnonzero(keep)
    backwards = np.flatnonzero(np.diff(log.times_s[rows]) < 0.0)
    if backwards.size:
        row = int(rows[backwards[0] + 1])
        before = log.times_s[rows[backwards[0]]]
        raise log.refusal(
            f"time runs backwards: {log.times_s[row]:.9g} s after {before:.9g} s; each row must be"
            " later than the row before", row,
        )  # fmt: skip
    times_s = log.times_s[rows]
    even_s, position = _unrounded(times_s), log.position[rows]
    if even_s is not None and _jerk(even_s, position) < _jerk(times_s, position):
        times_s = even_s  # else samples are lost, and the stamps are right
        notes.append(f"{log.path.name}: times are rounded to about the period, and were smoothed")
    rows = rows[np.concatenate([[True], np.diff(times_s) > 0.0])]
    times_s = times_s[np.concatenate([[True], np.diff(times_s) > 0.0])]
    log = replace(
        log, times_s=times_s, position=log.position[rows], torque=log.torque[rows],
        velocity=None if log.velocity is None else log.velocity[rows],
        command=None if log.command is None else log.command[rows],
    )  # fmt: skip
    _require_sense(log, robot)
    if log.velocity is not None and (wrong := _wrong_velocity(log)):
        notes.append(wrong)
        log = replace(log, velocity=None)
    return log, notes


def _undamaged(log: RobotLog) -> NDArray[np.bool_]:
    """Whether each row has possible values and a time near those around it, shape (rows,)."""
    values = np.column_stack([log.times_s, log.position, log.torque])
    if log.velocity is not None:
        values = np.column_stack([values, log.velocity])
    keep = np.asarray(
        np.isfinite(values).all(axis=1) & (np.abs(values[:, 1:]) < _LARGEST).all(axis=1)
    )
    if keep.sum() < 3:
        return keep
    # A median keeps the step of a pause, after which all times are far from those before.
    padded = np.pad(log.times_s[keep], _AROUND // 2, mode="edge")
    around_s = np.median(np.lib.stride_tricks.sliding_window_view(padded, _AROUND), axis=1)
    near = keep.copy()
    near[keep] = np.abs(log.times_s[keep] - around_s) < _FAR_S
    typical = np.median(log.position[keep], axis=0)
    spread = np.percentile(np.abs(log.position[keep] - typical), 95, axis=0) + 0.1
    return np.asarray(near & (np.abs(log.position - typical) < 20.0 * spread).all(axis=1))


def _unrounded(times_s: Vector) -> Vector | None:
    """Return smooth times for stamps whose resolution is about the period; None for others."""
    steps = np.diff(times_s)
    positive = steps[steps > 1e-9]
    if len(positive) < 10:
        return None
    resolution = float(positive.min())
    is_coarse = np.abs(positive / resolution - np.rint(positive / resolution)).max() < 0.02
    is_uneven = np.percentile(positive, 99.5) > 1.5 * resolution or (steps <= 0.0).any()
    if not (is_coarse and is_uneven and np.median(steps) < 1.5 * resolution):
        return None
    ends = [0, *(np.flatnonzero(steps > _JUMP * resolution) + 1).tolist(), len(times_s)]
    return np.concatenate([_smooth(times_s[i:j]) for i, j in itertools.pairwise(ends)])


def _jerk(times_s: Vector, position: Matrix) -> float:
    """Return how unevenly joints move if they are at these positions at these times."""
    steps_s = np.maximum(np.diff(times_s), 1e-6)
    return float(np.abs(np.diff(np.diff(position, axis=0) / steps_s[:, None], axis=0)).sum())


def _smooth(times_s: Vector) -> Vector:
    """Return a line through times plus the moving average of what is left."""
    if len(times_s) < 2 * _PATTERN:
        return times_s
    index = np.arange(len(times_s))
    line = np.polynomial.Polynomial.fit(index, times_s, 1)
    window = np.hanning(_PATTERN + 2)[1:-1]
    left = np.pad(times_s - line(index), _PATTERN // 2, mode="reflect", reflect_type="odd")
    return np.asarray(line(index) + np.convolve(left, window / window.sum(), "valid"))


def _require_sense(log: RobotLog, robot: RobotDescription) -> None:
    """Refuse logs that are too short, in degrees, or without torques."""
    if not log.is_long:
        span_s = float(np.ptp(log.times_s)) if len(log.times_s) else 0.0
        raise log.refusal(
            f"has {len(log.times_s)} rows over {span_s:.3g} s: must have {FEWEST_ROWS} rows over"
            f" {SHORTEST_S:g} s, better 20 s; funnel-hil identify --design FILE writes a"
            " trajectory that shows all joints"
        )
    if (period_s := float(np.median(np.diff(log.times_s)))) > _LONGEST_PERIOD_S:
        raise log.refusal(
            f"column {log.names.get('time', ['time'])[0]} has a row every {period_s:.3g} s: must be"
            f" at most {_LONGEST_PERIOD_S:g} s; --unit says if times are in ms, us or ns"
        )
    reach = np.abs(log.position).max(axis=0)
    most = np.maximum(np.abs(robot.lower_rad), np.abs(robot.upper_rad))
    most = np.where(np.isfinite(most), most, _FULL_TURNS_RAD)
    turns = ~np.array(robot.slides)
    for joint in np.flatnonzero(turns & (reach > np.maximum(1.2 * most, most + 1.0))).tolist():
        column = log.names["position"][joint]
        row = int(np.argmax(np.abs(log.position[:, joint])))
        is_degrees = np.radians(reach[joint]) <= most[joint] + 0.1
        hint = " It looks like degrees: --degrees converts them" if is_degrees else ""
        raise log.refusal(
            f"column {column} reaches {log.position[row, joint]:.4g} rad, but"
            f" {robot.joint_names[joint]} ends at {most[joint]:.4g} rad: must be in rad, and in the"
            f" order of the robot's joints.{hint}"
        )
    kind = "current" if log.is_current else "torque"
    for joint in np.flatnonzero(np.ptp(log.torque, axis=0) < 1e-9).tolist():
        raise log.refusal(
            f"column {log.names.get(kind, log.names['torque'])[joint]} is always"
            f" {log.torque[0, joint]:g}: identification needs measured torques or currents"
        )


def _wrong_velocity(log: RobotLog) -> str:
    """Return why the velocities are not the derivatives of the positions; empty if they are."""
    assert log.velocity is not None
    steps_s = np.diff(log.times_s)[:, None]
    steps_s = np.where(steps_s > _GAP_PERIODS * np.median(steps_s), 0.0, steps_s)  # not in a pause
    moved = np.cumsum(0.5 * (log.velocity[1:] + log.velocity[:-1]) * steps_s, axis=0)
    truly = np.cumsum(np.where(steps_s > 0.0, np.diff(log.position, axis=0), 0.0), axis=0)
    moved, truly = moved - moved.mean(axis=0), truly - truly.mean(axis=0)
    power = (truly**2).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (moved * truly).sum(axis=0) / power
    wrong = (np.abs(ratio - 1.0) > 0.2) & (power > 1e-3 * len(truly))
    if not wrong.any():
        return ""
    joint = int(np.argmax(wrong))
    return (
        f"{log.path.name}: column {log.names['velocity'][joint]} is {ratio[joint]:.3g} times the"
        " derivative of the position: velocities are computed from positions"
    )


def cutoff_hz(log: RobotLog) -> float:
    """Return the cutoff of the filters, from the spectrum of the log's own motion, Hz.

    `_ABOVE` times the frequency below which nearly all power of the velocities lies: what a rigid
    arm does at higher frequencies is friction at reversals, gears and noise.
    """
    times_s, rate_hz = _grid(log)
    velocity = log.velocity if log.velocity is not None else np.gradient(log.position, axis=0)
    velocity = _on(times_s, log.times_s, velocity)
    power = np.abs(np.fft.rfft(velocity * np.hanning(len(velocity))[:, None], axis=0)) ** 2
    hz = np.fft.rfftfreq(len(velocity), 1.0 / rate_hz)
    share = np.cumsum((power[hz < _SLOWER_HZ] / np.maximum(power.sum(axis=0), 1e-30)).mean(axis=1))
    highest_hz = hz[int(np.searchsorted(share, _POWER * share[-1]))]
    return float(np.clip(_ABOVE * highest_hz, _CUTOFFS_HZ[0], min(_CUTOFFS_HZ[1], 0.1 * rate_hz)))


def samples_of(log: RobotLog, cutoff: float) -> Samples:
    """Return even, filtered samples of a checked log.

    Args:
        log: the log.
        cutoff: Hz, of the filter of the torques.
    """
    times_s, rate_hz = _grid(log)
    position = lowpass(_on(times_s, log.times_s, log.position), rate_hz, _LIGHT * cutoff)
    if log.velocity is None:
        velocity = np.gradient(position, 1.0 / rate_hz, axis=0)
    else:
        velocity = lowpass(_on(times_s, log.times_s, log.velocity), rate_hz, _LIGHT * cutoff)
    acceleration = np.gradient(velocity, 1.0 / rate_hz, axis=0)
    torque = lowpass(_on(times_s, log.times_s, log.torque), rate_hz, cutoff)
    torque_rate = np.gradient(torque, 1.0 / rate_hz, axis=0)
    period_s = float(np.median(np.diff(log.times_s)))
    after = np.clip(np.searchsorted(log.times_s, times_s), 1, len(log.times_s) - 1)
    gap_s = log.times_s[after] - log.times_s[after - 1]
    in_gap = gap_s > max(_GAP_PERIODS * period_s, _SHORT_GAP / cutoff)
    reach = np.ones(2 * int(rate_hz / cutoff) + 1)
    is_known = np.convolve(in_gap, reach, "same") < 0.5
    notes: tuple[str, ...] = ()
    if in_gap.any():
        notes = (f"{log.path.name}: {in_gap.sum() / rate_hz:.3g} s in gaps are left out",)
    every = max(1, int(rate_hz / (_PER_CUTOFF * cutoff)))
    pick = slice(None, None, every)
    return Samples(
        log.path.name, times_s[pick], is_known[pick], position[pick], velocity[pick],
        acceleration[pick], torque[pick], torque_rate[pick], cutoff, notes,
    )  # fmt: skip


def moves(velocity: Matrix) -> NDArray[np.bool_]:
    """Return whether each joint moves fast enough, in both directions, shape (joints,)."""
    low, high = np.percentile(velocity, [4, 96], axis=0)
    return np.asarray((low < -_SLOW_RAD_S) & (high > _SLOW_RAD_S))


def lowpass(values: np.ndarray, rate_hz: float, cutoff: float) -> np.ndarray:
    """Return values without what is faster than a cutoff, without phase; time is the first axis.

    The gain is a Gaussian of the frequency, 0.7 at the cutoff. Both ends are continued by odd
    reflection.
    """
    rows = len(values)
    pad = min(rows - 1, int(2.0 * rate_hz / cutoff) + 1)
    ends = 2 * values[:1] - values[pad:0:-1], 2 * values[-1:] - values[-2 : -pad - 2 : -1]
    long = np.concatenate([ends[0], values, ends[1]])
    hz = np.fft.rfftfreq(len(long), 1.0 / rate_hz)
    gain = np.exp(-0.5 * math.log(2.0) * (hz / cutoff) ** 2)
    spectrum = np.fft.rfft(long, axis=0) * gain.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.fft.irfft(spectrum, len(long), axis=0)[pad : pad + rows])


def _grid(log: RobotLog) -> tuple[Vector, float]:
    """Return even times over a log, and their rate in Hz."""
    rate_hz = min(_MOST_HZ, 1.0 / float(np.median(np.diff(log.times_s))))
    return np.arange(log.times_s[0], log.times_s[-1], 1.0 / rate_hz), rate_hz


def _on(grid_s: Vector, times_s: Vector, values: Matrix) -> Matrix:
    return np.column_stack([np.interp(grid_s, times_s, column) for column in values.T])
