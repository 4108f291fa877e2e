"""Reads traces of networks from what other programs write: ping, candump, CSV and MCAP."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bus_schema.errors import did_you_mean
from bus_schema.messages.types import stamp_of
from bus_schema.user_files import read_text
from deploy.judge.link_delays import Measured
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.columns import MOST_BYTES

UNITS_MS = {"s": 1e3, "ms": 1.0, "us": 1e-3, "ns": 1e-6}
_PING = re.compile(r"(?:\[([\d.]+)\] )?.*seq=(\d+) .*?time[=<]([\d.]+) ms")
_CAN_LOG = re.compile(r"\(([\d.]+)\)\s+\S+\s+([0-9A-Fa-f]+)(?:#|\s+\[)")
_WRAP = 1 << 16


def from_ping(file: Path, interval_s: float) -> Measured:
    """Half of each round trip that ``ping`` shows; numbers that are missing were lost.

    Args:
        file: its output; with ``-D`` it has the times of answers.
        interval_s: between two requests, for output without times.
    """
    answers: dict[int, tuple[float, float]] = {}
    newest = 0
    for line in _lines(file):
        found = _PING.match(line)
        if found is None or "(DUP!)" in line:
            continue
        stamp, number, round_trip_ms = found[1], int(found[2]), float(found[3])
        number += max(0, newest - number + _WRAP // 2) // _WRAP * _WRAP  # it has 16 bits
        newest = max(newest, number)
        sent_s = float(stamp) - round_trip_ms / 1e3 if stamp else number * interval_s
        answers[number] = sent_s, round_trip_ms / 2
    if len(answers) < 2:
        raise ScenarioError(f"{file}: does not contain two replies in the format of ping")
    first, last = min(answers), max(answers)
    numbers = np.arange(first, last + 1)
    known = sorted(answers)
    times_s = np.interp(numbers, known, [answers[number][0] for number in known])
    missing = (0.0, float("nan"))
    return Measured(times_s, np.array([answers.get(int(n), missing)[1] for n in numbers]))


def from_candump(file: Path, request: str, answer: str) -> Measured:
    """The time from each frame of one identifier to the next one of another, in hexadecimal.

    A frame that is followed by its like first was lost.
    """
    wanted = {int(each, 16): each == request for each in (request, answer)}
    sent: list[float] = []
    delays: list[float] = []
    for line in _lines(file):
        found = _CAN_LOG.search(line)
        is_request = None if found is None else wanted.get(int(found[2], 16))
        if found is None or is_request is None:
            continue
        if is_request:
            sent.append(float(found[1]))
            delays.append(float("nan"))
        elif delays and np.isnan(delays[-1]):
            delays[-1] = 1e3 * (float(found[1]) - sent[-1])
    if not sent:
        raise ScenarioError(f"{file}: does not contain frame {request} in the format of candump")
    return Measured(np.array(sent), np.array(delays))


def from_csv(file: Path, sent: str, received: str | None, delay: str | None, unit: str) -> Measured:
    """Two columns of a CSV file: when messages were sent, and received or how long they took.

    Args:
        file: its first line has the names.
        sent: column of the times of sending.
        received: column of the times of reception; empty cells were lost.
        delay: column of delays, in place of `received`.
        unit: of all of them.
    """
    from pyarrow import ArrowException, csv, float64  # heavy, and needed by few commands

    names = [sent, str(received or delay)]
    options = csv.ConvertOptions(
        include_columns=names,
        column_types=dict.fromkeys(names, float64()),
        null_values=["", "nan", "NaN"],
    )
    try:
        table = csv.read_csv(file, convert_options=options)
    except (ArrowException, KeyError, OSError) as error:
        header = next(_lines(file), "")
        raise ScenarioError(
            f"{file}: {error}; the first line is {header[:200]!r}".replace("\n", " ")
        ) from error
    start, end = (table[name].to_numpy() * UNITS_MS[unit] for name in names)
    order = np.argsort(start, kind="stable")
    delays_ms = end - start if received else end
    return Measured(start[order] / 1e3, delays_ms[order])


def from_mcap(file: Path, topic: str, answer: str | None) -> Measured:
    """How long messages of an MCAP file took, by the stamps in their headers.

    Args:
        file: with messages in CDR that begin with a ROS header.
        topic: of the messages; each took from its stamp to when it was logged.
        answer: a topic whose messages carry the same stamps: each took from when the one was
            logged to when the other was. A message that is not answered was lost.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    logged: dict[str, dict[int, int]] = {name: {} for name in (topic, answer or topic)}
    known: set[str] = set()
    try:
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                known.add(channel.topic)
                stamp_ns = stamp_of(message.data)
                if channel.topic in logged and stamp_ns is not None:
                    logged[channel.topic].setdefault(stamp_ns, message.log_time)
    except (OSError, McapError) as error:
        raise ScenarioError(f"{file}: cannot be read as MCAP: {error}") from error
    for name, found in logged.items():
        if not found:
            topics = ", ".join(sorted(known))
            hint = did_you_mean(name, sorted(known))
            raise ScenarioError(f"{file}: no stamps on {name}; topics are {topics}{hint}")
    stamps = np.array(sorted(logged[topic]), dtype=np.int64)
    ends = [logged[answer or topic].get(int(stamp)) for stamp in stamps]
    starts = np.array([logged[topic][int(s)] for s in stamps]) if answer else stamps
    delays_ms = [
        float("nan") if end is None else (end - int(start)) / 1e6
        for start, end in zip(starts, ends, strict=True)
    ]
    return Measured((starts - starts[0]) / 1e9, np.array(delays_ms))


def _lines(file: Path) -> Iterator[str]:
    try:
        yield from read_text(file, MOST_BYTES).splitlines()
    except OSError as error:
        raise ScenarioError(f"{file}: cannot be read: {error}") from error
