"""Delays that other programs measured: output of ping and iperf3, and tables."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.configuration import shown
from bus_schema.foreign_files import refuse_foreign
from bus_schema.tables import MOST_BYTES, column_names, read_columns
from bus_schema.time_units import UNITS_MS, check_interval, split_unit
from bus_schema.user_files import read_bytes, read_text

LONGEST_MS = 60_000.0
ACK_ROUND_TRIP = "tcp.analysis.ack_rtt"
"""tshark's field: the time from a TCP segment to its ACK."""
_ACK_TIMES = ("frame.time_epoch", "frame.time_relative")
_REPLY = re.compile(
    r"(?:\[(?P<stamp>[\d.]+)\] )?.*seq=(?P<number>\d+) .*?time[=<](?P<trip_ms>[\d.]+) ms"
)
_UNANSWERED = re.compile(r"(?:Request timeout for|no answer yet for|From) .*seq[ =](?P<number>\d+)")
_FIRST_LINES = re.compile(rb"^PING \S+ \(|^(\[[\d.]+\] )?\d+ bytes from .* time[=<]", re.MULTILINE)
_WINDOWS = re.compile(r"(?i:bytes)=\d+ .*TTL=\d+")
_STATISTICS = re.compile(
    r"(\d{1,12}) packets transmitted, \d+( packets)? received(?:.* time (\d{1,12})ms)?"
)
_NO_REPLIES = (
    "does not contain two replies in the format of ping: make it on Linux, LC_ALL=C ping -D HOST"
)
_OF_WINDOWS = (
    "is output of Windows' ping, which has no times and numbers, and sends once in 1 s: use ping -D"
    " -i 0.01 HOST on Linux or in WSL, funnel-hil link, or a table with time_s and round_trip_ms"
)
_MOST_LOST = 1000
"""With more requests for each reply, the numbers are damaged and would fill the memory."""
_BEGINNING = 4000
_WRAP = 1 << 16
_USUAL_INTERVAL_S = 1.0
_SENT = {"time", "t", "timestamp", "sent", "send", "send_time", "sent_time", "time_sent", "tx"}
ROUND_TRIPS = {"rtt", "round_trip", "round_trip_time", "ping"}
"""Names of columns, without units."""
_ONE_WAY = {"delay", "latency", "owd", "one_way_delay", "one_way_latency"}
_OF_TRACES = {"time_s", "delay_ms", "round_trip_ms"}
_LONGEST_WITHOUT_UNIT = 1.0
"""Messages of a loop are rarely 1 s apart, and often 1 ms."""
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
    if _WINDOWS.search(beginning.decode("ascii", "ignore")):
        raise ValueError(f"{path} {_OF_WINDOWS}")
    if beginning.lstrip().startswith(b"{") and (report := _iperf_report(path)) is not None:
        return _from_iperf(path, report)
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
    has_times = any(each and each["stamp"] for each in map(_REPLY.match, lines))
    if has_times and interval_s is not None:
        raise ValueError(f"{path}: --interval must be left out: it has times, by ping -D")
    if interval_s is None:
        interval_s, source = _interval_s(lines)
    else:
        source = "as given"
    replies, unanswered = _requests(path, lines, interval_s)
    if len(replies) < 2:
        is_windows = any(map(_WINDOWS.search, lines))
        raise ValueError(f"{path} {_OF_WINDOWS}" if is_windows else f"{path}: {_NO_REPLIES}")
    numbers = _numbers(path, lines, {*replies, *unanswered}, len(replies))
    known = sorted(replies)
    sent_s = np.array([replies[number][0] for number in known])
    gap_s = (sent_s[-1] - sent_s[0]) / (known[-1] - known[0])
    times_s = np.interp(numbers, known, sent_s)
    times_s += gap_s * (numbers - np.clip(numbers, known[0], known[-1]))  # beyond the replies
    times_s = np.maximum.accumulate(times_s)  # ping rounds long round trips to whole milliseconds
    missing = (0.0, float("nan"))
    trips_ms = np.array([replies.get(int(n), missing)[1] for n in numbers])
    interval = "" if has_times else f", {interval_s:g} s between requests ({source})"
    assumed = f"output of ping{interval}, missing numbers are lost: {_HALVES}"
    return RoundTrips(times_s, trips_ms, assumed)


def _requests(
    path: Path, lines: Sequence[str], interval_s: float
) -> tuple[dict[int, tuple[float, float]], set[int]]:
    """Return when each answered request was sent and its round trip in ms, and the unanswered."""
    replies: dict[int, tuple[float, float]] = {}
    unanswered: set[int] = set()
    newest = 0
    for line_number, line in enumerate(lines, 1):
        reply = _REPLY.match(line)
        found = reply or _UNANSWERED.search(line)
        if found is None or "(DUP!)" in line:
            continue
        try:
            number = int(found["number"])
            round_trip_ms = float(reply["trip_ms"]) if reply else 0.0
            stamp_s = float(reply["stamp"]) if reply and reply["stamp"] else None
        except ValueError as error:
            raise ValueError(f"{path}, line {line_number}: {error}") from error
        if (replies or unanswered) and number > newest + _WRAP:
            raise ValueError(f"{path}, line {line_number}: seq={number}: must be at most {_WRAP}"
                             f" above {newest}")  # fmt: skip
        number += max(0, newest - number + _WRAP // 2) // _WRAP * _WRAP  # it has 16 bits
        newest = max(newest, number)
        if reply is None:
            unanswered.add(number)
        else:
            sent_s = number * interval_s if stamp_s is None else stamp_s - round_trip_ms / 1e3
            replies[number] = sent_s, round_trip_ms
    return replies, unanswered


def _numbers(path: Path, lines: Sequence[str], seen: set[int], replies: int) -> NDArray[np.int64]:
    """Return the numbers of all requests, as far as the output shows its beginning and end."""
    first, last = min(seen), max(seen)
    is_whole = any(line.startswith("PING ") for line in lines)
    statistics = _statistics(lines)
    # Linux counts from 1; others, which write "packets received", from 0.
    start = 0 if first == 0 or (statistics and statistics[2]) else 1
    if is_whole:
        first = min(first, start)
    if statistics and (is_whole or int(statistics[1]) <= _WRAP):  # else numbers may have wrapped
        last = max(last, start + int(statistics[1]) - 1)
    if last - first >= _MOST_LOST * replies:
        raise ValueError(f"{path}: {replies} replies to requests {first} to {last}: must be at"
                         f" least one of {_MOST_LOST}")  # fmt: skip
    return np.arange(first, last + 1)


def _statistics(lines: Sequence[str]) -> re.Match[str] | None:
    """Return what the last lines say: number of requests, and the time that they took in ms."""
    return next(filter(None, map(_STATISTICS.search, reversed(lines))), None)


def _interval_s(lines: Sequence[str]) -> tuple[float, str]:
    """Return the time between two requests in s, and where it is from, for a reader."""
    found = _statistics(lines)
    if found is not None and int(found[1]) > 1 and int(found[3] or 0):
        return 1e-3 * int(found[3]) / (int(found[1]) - 1), "by its statistics"
    return _USUAL_INTERVAL_S, "ping's default, assumed"


def _iperf_report(path: Path) -> dict[str, Any] | None:
    """Return what ``iperf3 --json`` wrote; None where a file is something else."""
    try:
        report = json.loads(read_text(path, MOST_BYTES))
        is_iperf = report["start"]["version"].startswith("iperf 3")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return report if is_iperf else None


def _from_iperf(path: Path, report: dict[str, Any]) -> RoundTrips:
    """Return the round trips of a TCP test's first stream, one for each interval of the report.

    Raises:
        ValueError: it failed, has no round trips, as over UDP, or its times fall.
    """
    if "error" in report:
        raise ValueError(f"{path}: iperf3 failed: {shown(report['error'])}")
    try:
        streams = [each["streams"][0] for each in report["intervals"] if each["streams"]]
        streams = [each for each in streams if not each.get("omitted")]
        found = np.array([[each["end"], each.get("rtt") or 0.0] for each in streams], dtype=float)
        total = dict(report["end"].get("sum") or {})
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is a damaged report of iperf3: {error!r}") from error
    if len(found) < 2 or not found[:, 1].all():
        raise ValueError(f"{path} is output of iperf3 without round trips:{_instead(total)}"
                         " measure delays with ping -D or funnel-hil link")  # fmt: skip
    if not (np.diff(found[:, 0]) >= 0.0).all():
        raise ValueError(f"{path}: the times (end) of iperf3's intervals must not fall")
    assumed = (
        "iperf3's round trips, which the kernel smooths, while the test fills the link; losses are"
        f" not in them: {_HALVES}"
    )
    return RoundTrips(found[:, 0], found[:, 1] / 1e3, assumed)


def _instead(total: dict[str, Any]) -> str:
    """Return the keys of the link for what a test over UDP measured, else what to run."""
    if "jitter_ms" not in total:
        return " run iperf3 -J on the sender, over TCP, or"
    keys = (("rate_kbit_s", "bits_per_second", 1e-3, 4), ("jitter_ms", "jitter_ms", 1.0, 3),
            ("loss", "lost_percent", 1e-2, 3))  # fmt: skip
    found = [f"{key}: {scale * total[name]:.{digits}g}" for key, name, scale, digits in keys
             if isinstance(total.get(name), int | float)]  # fmt: skip
    return f" use {', '.join(found[:-1])} and {found[-1]};" if found[1:] else ""


def _from_table(path: Path, names: Sequence[str]) -> RoundTrips | None:
    """Return the delays of a table with one column of times and one of delays, by their names.

    Raises:
        ValueError: no columns have such names, one needs a unit, times are in another, or a delay
            is out of range.
    """
    if len(_OF_TRACES & set(names)) > 1 and "time_s" in names:
        return None
    words = {name: split_unit(name) for name in names}
    times = [name for name in names if words[name][0] in _SENT]
    delays = [name for name in names if words[name][0] in _ONE_WAY | ROUND_TRIPS]
    if len(times) != 1 or len(delays) != 1:
        if not _OF_TRACES & set(names):
            refuse_foreign(path, read_bytes(path, MOST_BYTES))
            raise ValueError(f"{path}: the columns are {shown(', '.join(names))}: one must be of"
                             f" times ({_listed(_SENT)}) and one of delays"
                             f" ({_listed(_ONE_WAY | ROUND_TRIPS)}), with units, as time_s and"
                             " delay_ms or round_trip_ms; or name them: funnel-hil trace import csv"
                             f" {path} --from TIME --delay DELAY")  # fmt: skip
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
    gap = float(np.median(np.diff(sent_s[order]))) if len(sent_s) > 1 else 0.0
    if not words[time][1] and gap >= _LONGEST_WITHOUT_UNIT:
        raise ValueError(f"{path}: the name of column {time} has no unit, and its times are usually"
                         f" {gap:.3g} apart: name it {time}_ms or {time}_s")  # fmt: skip
    delays_ms = columns.values[delay] * UNITS_MS[unit]
    is_wrong = (delays_ms < 0.0) | (delays_ms > LONGEST_MS)
    columns.refuse_where(is_wrong, delay, f"delays must be 0 to {LONGEST_MS:g} ms")
    is_one_way = words[delay][0] in _ONE_WAY
    how = "empty cells are lost" + ("" if is_one_way else f": {_HALVES}")
    assumed = f"columns {time} in {words[time][1] or 's'} and {delay} in {unit}, {how}"
    return RoundTrips(sent_s[order], delays_ms[order], assumed, is_one_way)


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names))
