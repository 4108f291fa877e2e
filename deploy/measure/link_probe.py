"""Measures a link at the rate and size of a loop: one-way delays, losses and order."""

from __future__ import annotations

import secrets
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.runtime.clock import own_kernel
from deploy.judge.findings.link_delays import MeasuredDelays
from deploy.measure.probe_frames import MOST_BYTES, REPEATED, FrameStream, ProbeFrame

_LAST_ANSWERS_S = 1.0
_WINDOW_S = 10.0
_FEWEST_WINDOWS = 3

Progress = Callable[[float, Vector, int], None]
"""Called with the time, and with round trips in ms and the number of frames since the last call."""


@dataclass(frozen=True)
class ProbeTimes:
    """Times of frames, ns on the monotonic clock of each side, 0 for never; shape (frames,).

    Attributes:
        sent_ns: sent by this side.
        received_ns: received by the other one.
        answered_ns: answered there.
        returned_ns: received back.
        has_one_clock: whether both sides have the same clock, being under one kernel.
    """

    sent_ns: NDArray[np.int64]
    received_ns: NDArray[np.int64]
    answered_ns: NDArray[np.int64]
    returned_ns: NDArray[np.int64]
    has_one_clock: bool

    @property
    def round_trips_ms(self) -> Vector:
        """Of the frames that came back, without the time that answering took."""
        back = self.returned_ns > 0
        there_ns = self.answered_ns[back] - self.received_ns[back]
        return np.asarray((self.returned_ns - self.sent_ns)[back] - there_ns) / 1e6


@dataclass(frozen=True)
class MeasuredLink:
    """Measurements of a link.

    Attributes:
        there: frames on their way there.
        back: answers on their way back.
        reordered: how many of each came behind a younger one.
        offset_ms: how far the other side's clock is ahead, at the start.
        drift_ppm: by how much it is faster.
        uncertainty_ms: of both one-way delays, in opposite senses; their sum is certain.
    """

    there: MeasuredDelays
    back: MeasuredDelays
    reordered: tuple[int, int]
    offset_ms: float
    drift_ppm: float
    uncertainty_ms: float


def probe(
    link: socket.socket,
    rate_hz: float,
    size: int,
    duration_s: float,
    is_stop_requested: Callable[[], bool],
    on_progress: Progress,
) -> ProbeTimes:
    """Send frames at a rate, and take their answers.

    Args:
        link: connected to a `ProbeServer`; a UDP or a TCP socket.
        rate_hz: frames per second.
        size: of a frame, bytes.
        duration_s: how long.
        is_stop_requested: whether to stop before.
        on_progress: called about once a second.
    """
    count = max(2, round(rate_hz * duration_s))
    times = np.zeros((4, count), dtype=np.int64)
    session, kernel, stream = secrets.randbits(32), own_kernel(), FrameStream()
    is_stream, has_one_clock = link.type == socket.SOCK_STREAM, False
    number, reported, begun_ns, shown_ns = 0, 0, time.monotonic_ns(), time.monotonic_ns()
    end_ns = begun_ns + round((duration_s + _LAST_ANSWERS_S) * 1e9)
    while (now_ns := time.monotonic_ns()) < end_ns:
        due_ns = begun_ns + round(number / rate_hz * 1e9)
        if is_stop_requested():
            break
        if number < count and now_ns >= due_ns:
            times[0, number] = sent_ns = time.monotonic_ns()
            _send(link, ProbeFrame(size, session, number, kernel, sent_ns).encode())
            number += 1
        wait_ns = due_ns - now_ns if number < count else end_ns - now_ns
        if select.select([link], [], [], max(0, min(wait_ns, 100_000_000)) * 1e-9)[0]:
            data, returned_ns = _receive(link), time.monotonic_ns()
            found = stream.cut(data) if is_stream else [ProbeFrame.decode(data)]
            for frame in found:
                if frame is not None and frame.session == session and frame.number < number:
                    _note(times, frame, returned_ns)
                    has_one_clock = frame.kernel == kernel != 0
        elif now_ns - shown_ns > 1e9 and wait_ns > 0:
            back = times[:, reported:number]
            back = back[:, back[3] > 0]
            on_progress((now_ns - begun_ns) * 1e-9, (back[3] - back[0]) / 1e6, number - reported)
            reported, shown_ns = number, now_ns
    sent, received, answered, returned = times[:, :number]
    return ProbeTimes(sent, received, answered, returned, has_one_clock)


def _send(link: socket.socket, frame: bytes) -> None:
    try:
        link.sendall(frame)
    except ConnectionRefusedError:  # of a datagram before: there is no listener yet
        return


def _receive(link: socket.socket) -> bytes:
    try:
        data = link.recv(MOST_BYTES)
    except ConnectionRefusedError:
        return b""
    if not data and link.type == socket.SOCK_STREAM:
        raise ConnectionResetError("the other side has closed the connection")
    return data


def _note(times: NDArray[np.int64], frame: ProbeFrame, returned_ns: int) -> None:
    for back, received_ns in enumerate(frame.received_ns):
        if received_ns and frame.number >= back:
            times[1, frame.number - back] = received_ns
    if not times[3, frame.number]:  # no copy
        times[2:, frame.number] = frame.answered_ns, returned_ns


def evaluate(times: ProbeTimes) -> MeasuredLink:
    """One-way delays, losses and order.

    A frame of which no answer says whether it arrived, as `REPEATED` of them were lost, counts as
    lost on the way back.

    Raises:
        ValueError: too few frames came back.
    """
    sent, received, returned = times.sent_ns, times.received_ns, times.returned_ns
    back = returned > 0
    if back.sum() < 2 * _FEWEST_WINDOWS:
        raise ValueError(f"{int(back.sum())} of {len(sent)} frames came back")
    raw_there, raw_back = received - sent, returned - times.answered_ns
    elapsed_s = (sent - sent[0]) / 1e9
    line, uncertainty_ns = (np.zeros(2), 0.0)
    if not times.has_one_clock:
        line, uncertainty_ns = clock_offset_ns(elapsed_s[back], raw_there[back], raw_back[back])
    offset_ns = line[0] + line[1] * elapsed_s
    arrived = received > 0
    heard_of = np.convolve(back, np.ones(REPEATED), "full")[REPEATED - 1 :][: len(back)] > 0
    known = arrived | heard_of
    delays_there = np.where(arrived, np.maximum(raw_there - offset_ns, 0.0), np.nan) / 1e6
    delays_back = np.where(back, np.maximum(raw_back + offset_ns, 0.0), np.nan) / 1e6
    came = arrived | ~known
    answered_ns = np.where(back, times.answered_ns, received) - offset_ns - sent[0]
    answered_s = np.interp(elapsed_s, elapsed_s[arrived], answered_ns[arrived] / 1e9)
    order = np.flatnonzero(came)[np.argsort(answered_s[came], kind="stable")]
    return MeasuredLink(
        MeasuredDelays(elapsed_s[known], delays_there[known]),
        MeasuredDelays(answered_s[order], delays_back[order]),
        (_reordered(received[arrived]), _reordered(returned[back])),
        line[0] / 1e6, line[1] / 1e3, uncertainty_ns / 1e6,
    )  # fmt: skip


def clock_offset_ns(
    elapsed_s: Vector, raw_there_ns: NDArray[np.int64], raw_back_ns: NDArray[np.int64]
) -> tuple[Vector, float]:
    """Return the offset of the other clock, as a line over time, and its uncertainty, ns.

    In each window the least apparent delays there and back are taken for equal, as those of a link
    without queues are (least-delay filter). The uncertainty is half of their sum, as neither is
    negative, and what the line misses.

    Args:
        elapsed_s: when frames were sent, shape (frames,).
        raw_there_ns: arrival there, by that clock, less departure here, by this one.
        raw_back_ns: arrival here, by this clock, less departure there, by that one.
    """
    duration_s = float(elapsed_s[-1] - elapsed_s[0])
    windows = max(_FEWEST_WINDOWS, round(duration_s / _WINDOW_S))
    edges = np.linspace(elapsed_s[0], elapsed_s[-1], windows + 1)[1:-1]
    groups = [
        each
        for each in np.split(np.arange(len(elapsed_s)), np.searchsorted(elapsed_s, edges))
        if each.size
    ]
    line = np.zeros(2)
    for _ in range(2):  # again without the drift within windows
        drifted = line[1] * elapsed_s
        least_there = np.array([(raw_there_ns - drifted)[each].min() for each in groups])
        least_back = np.array([(raw_back_ns + drifted)[each].min() for each in groups])
        middle_s = np.array([elapsed_s[each].mean() for each in groups])
        offsets = (least_there - least_back) / 2
        about = middle_s - middle_s.mean()
        slope = float((about * offsets).sum() / (about**2).sum())
        line = np.array([offsets.mean() - slope * middle_s.mean(), line[1] + slope])
    missed = offsets - offsets.mean() - slope * about
    spread = (least_there + least_back).min() / 2
    return line, float(spread + np.abs(missed).max())


def _reordered(arrivals_ns: NDArray[np.int64]) -> int:
    """Return the number that arrived after one that was sent after them."""
    if arrivals_ns.size < 2:
        return 0
    earliest_after = np.minimum.accumulate(arrivals_ns[::-1])[::-1]
    return int((arrivals_ns[:-1] > earliest_after[1:]).sum())
