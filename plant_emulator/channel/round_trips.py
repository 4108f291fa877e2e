"""Delays that other programs measured: output of ping and iperf3, and tables."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.tables import MOST_BYTES, column_names, read_columns
from bus_schema.time_units import UNITS_MS, check_interval, split_unit
from bus_schema.user_files import read_text

ACK_ROUND_TRIP = "tcp.analysis.ack_rtt"
"""tshark's field: the time from a TCP segment to its ACK."""
_ACK_TIMES = ("frame.time_epoch", "frame.time_relative")
_REPLY = re.compile(r"(?:\[([\d.]+)\] )?.*seq=(\d+) .*?time[=<]([\d.]+) ms")
_FIRST_LINES = re.compile(rb"^PING \S+ \(|^(\[[\d.]+\] )?\d+ bytes from .* time[=<]", re.MULTILINE)
_STATISTICS = re.compile(r"(\d+) packets transmitted, .* time (\d+)ms")
_IPERF = re.compile(rb"\A\s*\{.*\"version\":\s*\"iperf 3", re.DOTALL)
_BEGINNING = 4000
_WRAP = 1 << 16
_USUAL_INTERVAL_S = 1.0
_SENT = {"time", "t", "timestamp", "sent", "send", "send_time", "sent_time", "time_sent", "tx"}
_ROUND_TRIP = {"rtt", "round_trip", "round_trip_time", "ping"}
_ONE_WAY = {"delay", "latency", "owd", "one_way_delay", "one_way_latency"}
_HALVES = "each direction replays half of each round trip"


class RoundTrips(NamedTuple):
    """Round trips, or one-way delays, in the order of sending.

    Attributes:
        sent_s: when each message was sent, shape (messages,).
        round_trips_ms: how long each took, NaN where it was lost; shape (messages,).
        assumed: how they are read, for the reader of a result.
        is_one_way: they are one-way delays.
    """

    sent_s: Vector
    round_trips_ms: Vector
    assumed: str
    is_one_way: bool = False


def measured_round_trips(path: Path) -> RoundTrips | None:
    """Return the delays in a file of ping, iperf3 or tshark, or in a table; None for a trace.

    Raises:
        ValueError: it cannot be read, or has no delays.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        beginning = file.read(_BEGINNING)
    if _FIRST_LINES.search(beginning):
        return from_ping(path, read_text(path).splitlines(), None)
    if _IPERF.match(beginning):
        return _from_iperf(path)
    names = column_names(path)
    time = next((each for each in _ACK_TIMES if each in names), None)
    if ACK_ROUND_TRIP in names and time is not None:
        columns = read_columns(path, [time, ACK_ROUND_TRIP], None)
        return of_acks(columns.values[time], columns.values[ACK_ROUND_TRIP])
    return _from_table(path, names)


def of_acks(times_s: Vector, round_trips_s: Vector) -> RoundTrips:
    """Return the round trips of the packets that have one: ACKs, which end at their times.

    Args:
        times_s: of all packets.
        round_trips_s: NaN for a packet that is no ACK.
    """
    is_ack = np.isfinite(round_trips_s)
    sent_s = (times_s - round_trips_s)[is_ack]
    order = np.argsort(sent_s, kind="stable")
    assumed = f"round trips from TCP segments to their ACKs, no losses: {_HALVES}"
    return RoundTrips(sent_s[order], 1e3 * round_trips_s[is_ack][order], assumed)


def from_ping(path: Path, lines: Sequence[str], interval_s: float | None) -> RoundTrips:
    """Return the round trips that ``ping`` shows; numbers that are missing were lost.

    Args:
        path: the file, for messages.
        lines: of its output; with ``-D`` they have the times of replies.
        interval_s: between two requests, for output without times; None: as its statistics say, or
            else ping's usual one.

    Raises:
        ValueError: there are not two replies, or there are times beside `interval_s`.
    """
    found = [each for each in map(_REPLY.match, lines) if each and "(DUP!)" not in each.string]
    has_times = any(each[1] for each in found)
    if has_times and interval_s is not None:
        raise ValueError(f"{path}: --interval must be left out: it has times, by ping -D")
    if interval_s is None:
        interval_s, source = _interval_s(lines)
    else:
        source = "as given"
    replies: dict[int, tuple[float, float]] = {}
    newest = 0
    for reply in found:
        stamp, number, round_trip_ms = reply[1], int(reply[2]), float(reply[3])
        number += max(0, newest - number + _WRAP // 2) // _WRAP * _WRAP  # it has 16 bits
        newest = max(newest, number)
        sent_s = float(stamp) - round_trip_ms / 1e3 if stamp else number * interval_s
        replies[number] = sent_s, round_trip_ms
    if len(replies) < 2:
        raise ValueError(f"{path}: does not contain two replies in the format of ping")
    numbers, known = np.arange(min(replies), max(replies) + 1), sorted(replies)
    times_s = np.interp(numbers, known, [replies[number][0] for number in known])
    times_s = np.maximum.accumulate(times_s)  # ping rounds long round trips to whole milliseconds
    missing = (0.0, float("nan"))
    trips_ms = np.array([replies.get(int(n), missing)[1] for n in numbers])
    interval = "" if has_times else f", {interval_s:g} s between requests ({source})"
    assumed = f"output of ping{interval}, missing numbers are lost: {_HALVES}"
    return RoundTrips(times_s, trips_ms, assumed)


def _interval_s(lines: Sequence[str]) -> tuple[float, str]:
    """Return the time between requests of output without times, and who says it."""
    for line in reversed(lines):
        found = _STATISTICS.search(line)
        if found is not None and int(found[1]) > 1 and int(found[2]):
            return 1e-3 * int(found[2]) / (int(found[1]) - 1), "by its statistics"
    return _USUAL_INTERVAL_S, "ping's default, assumed"


def _from_iperf(path: Path) -> RoundTrips | None:
    """Return the round trips of a TCP test's first stream, one for each interval of the report.

    Raises:
        ValueError: it was a test over UDP, whose report has no delays.
    """
    try:
        report = json.loads(read_text(path, MOST_BYTES))
        streams = [each["streams"][0] for each in report["intervals"] if each["streams"]]
        streams = [each for each in streams if not each.get("omitted")]
        found = np.array([[each["end"], each.get("rtt", 0.0)] for each in streams], dtype=float)
        total = report["end"].get("sum", {})
    except (ValueError, LookupError, TypeError, AttributeError):
        return None
    if len(found) < 2 or not found[:, 1].all():
        raise ValueError(f"{path} is output of iperf3 without round trips:{_udp(total)}"
                         " measure delays with ping -D or funnel-hil link")  # fmt: skip
    assumed = (
        "iperf3's round trips, which the kernel smooths, while the test fills the link; losses are"
        f" not in them: {_HALVES}"
    )
    return RoundTrips(found[:, 0], found[:, 1] / 1e3, assumed)


def _udp(total: dict[str, float]) -> str:
    """Return the keys of the link for what a test over UDP measured."""
    if "jitter_ms" not in total:
        return ""
    return (
        f" use rate_kbit_s: {total['bits_per_second'] / 1e3:.4g},"
        f" jitter_ms: {total['jitter_ms']:.3g} and loss: {total['lost_percent'] / 100:.3g};"
    )


def _from_table(path: Path, names: Sequence[str]) -> RoundTrips | None:
    """Return the delays of a table with one column of times and one of delays, by their names.

    Raises:
        ValueError: the name of the delays has no unit, or the times are in another unit.
    """
    if {"delay_ms", "round_trip_ms"} & set(names) and "time_s" in names:
        return None
    words = {name: split_unit(name) for name in names}
    times = [name for name in names if words[name][0] in _SENT]
    delays = [name for name in names if words[name][0] in _ONE_WAY | _ROUND_TRIP]
    if len(times) != 1 or len(delays) != 1:
        return None
    (time,), (delay,) = times, delays
    unit = words[delay][1]
    if not unit:
        command = f"funnel-hil trace import csv {path} --from '{time}' --delay '{delay}'"
        raise ValueError(f"{path}: the name of column {delay} has no unit, such as {delay}_ms:"
                         f" rename it, or use {command} --delay-unit ms")  # fmt: skip
    columns = read_columns(path, [time, delay], None)
    columns.refuse_where(~np.isfinite(columns.values[time]), time, "must be a time in each row")
    sent_s = columns.values[time] * UNITS_MS[words[time][1] or "s"] / 1e3
    order = np.argsort(sent_s, kind="stable")
    try:
        check_interval(sent_s[order])
    except ValueError as error:
        raise ValueError(f"{path}, column {time}: {error}") from error
    is_one_way = words[delay][0] in _ONE_WAY
    how = "empty cells are lost" + ("" if is_one_way else f": {_HALVES}")
    assumed = f"columns {time} in {words[time][1] or 's'} and {delay} in {unit}, {how}"
    return RoundTrips(sent_s[order], (columns.values[delay] * UNITS_MS[unit])[order], assumed,
                      is_one_way)  # fmt: skip
