"""Round trips that other programs measured: output of ping, and tables of tshark."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.tables import column_names, read_columns
from bus_schema.user_files import read_text

ACK_ROUND_TRIP = "tcp.analysis.ack_rtt"
"""tshark's field: the time from a TCP segment to its ACK."""
_ACK_TIMES = ("frame.time_epoch", "frame.time_relative")
_REPLY = re.compile(r"(?:\[([\d.]+)\] )?.*seq=(\d+) .*?time[=<]([\d.]+) ms")
_FIRST_LINES = re.compile(rb"^PING \S+ \(|^(\[[\d.]+\] )?\d+ bytes from .* time[=<]", re.MULTILINE)
_BEGINNING = 4000
_WRAP = 1 << 16


class RoundTrips(NamedTuple):
    """Round trips in the order of sending.

    Attributes:
        sent_s: when each request was sent, shape (messages,).
        round_trips_ms: how long each took, NaN where it was lost; shape (messages,).
    """

    sent_s: Vector
    round_trips_ms: Vector


def measured_round_trips(path: Path) -> RoundTrips | None:
    """Return the round trips in a file of ping or tshark; None for other files.

    Raises:
        ValueError: it cannot be read, or its replies have no times.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        is_ping = _FIRST_LINES.search(file.read(_BEGINNING)) is not None
    if is_ping:
        return from_ping(path, read_text(path).splitlines(), None)
    names = column_names(path)
    time = next((each for each in _ACK_TIMES if each in names), None)
    if ACK_ROUND_TRIP not in names or time is None:
        return None
    columns = read_columns(path, [time, ACK_ROUND_TRIP], None)
    return of_acks(columns.values[time], columns.values[ACK_ROUND_TRIP])


def of_acks(times_s: Vector, round_trips_s: Vector) -> RoundTrips:
    """Return the round trips of the packets that have one: ACKs, which end at their times.

    Args:
        times_s: of all packets.
        round_trips_s: NaN for a packet that is no ACK.
    """
    is_ack = np.isfinite(round_trips_s)
    sent_s = (times_s - round_trips_s)[is_ack]
    order = np.argsort(sent_s, kind="stable")
    return RoundTrips(sent_s[order], 1e3 * round_trips_s[is_ack][order])


def from_ping(path: Path, lines: Iterable[str], interval_s: float | None) -> RoundTrips:
    """Return the round trips that ``ping`` shows; numbers that are missing were lost.

    Args:
        path: the file, for messages.
        lines: of its output; with ``-D`` they have the times of replies.
        interval_s: between two requests, for output without times.

    Raises:
        ValueError: there are not two replies, or not one of times and `interval_s`.
    """
    replies: dict[int, tuple[float, float]] = {}
    newest = 0
    for line in lines:
        found = _REPLY.match(line)
        if found is None or "(DUP!)" in line:
            continue
        stamp, number, round_trip_ms = found[1], int(found[2]), float(found[3])
        number += max(0, newest - number + _WRAP // 2) // _WRAP * _WRAP  # it has 16 bits
        newest = max(newest, number)
        sent_s = _sent_s(path, stamp, number, interval_s)
        replies[number] = sent_s - (round_trip_ms / 1e3 if stamp else 0.0), round_trip_ms
    if len(replies) < 2:
        raise ValueError(f"{path}: does not contain two replies in the format of ping")
    numbers, known = np.arange(min(replies), max(replies) + 1), sorted(replies)
    times_s = np.interp(numbers, known, [replies[number][0] for number in known])
    times_s = np.maximum.accumulate(times_s)  # ping rounds long round trips to whole milliseconds
    missing = (0.0, float("nan"))
    return RoundTrips(times_s, np.array([replies.get(int(n), missing)[1] for n in numbers]))


def _sent_s(path: Path, stamp: str | None, number: int, interval_s: float | None) -> float:
    if stamp and interval_s is not None:
        raise ValueError(f"{path}: --interval must be left out: it has times, by ping -D")
    if not stamp and interval_s is None:
        way = "use ping -D, or funnel-hil trace import ping with --interval"
        raise ValueError(f"{path}: its replies have no times: {way}")
    return float(stamp) if stamp else number * float(interval_s or 0.0)
