"""Reads traces of networks from what other programs write: ping, candump, CSV and MCAP."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bus_schema.errors import did_you_mean
from bus_schema.foreign_files import refuse_foreign
from bus_schema.messages.types import stamp_of
from bus_schema.tables import MOST_BYTES, read_columns
from bus_schema.time_units import UNITS_MS
from bus_schema.user_files import read_text
from deploy.judge.findings.link_delays import MeasuredDelays
from deploy.measure.recordings import opened
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel import round_trips
from plant_emulator.channel.round_trips import ACK_ROUND_TRIP

_CAN_LOG = re.compile(r"\(([\d.]+)\)\s+(\S+)\s+([0-9A-Fa-f]+)(?:#|\s+\[)")


def from_ping(file: Path, interval_s: float | None = None) -> MeasuredDelays:
    """Half of each round trip that ``ping`` shows; numbers that are missing were lost.

    Args:
        file: its output; with ``-D`` it has the times of answers.
        interval_s: between two requests, for output without times; None: by its statistics.

    Raises:
        ScenarioError: it cannot be read, or has times beside `interval_s`.
    """
    try:
        found = round_trips.from_ping(file, _lines(file, "ping"), interval_s)
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    return MeasuredDelays(found.sent_s, found.round_trips_ms / 2)


def from_candump(
    file: Path, request: str, answer: str, interface: str | None = None
) -> dict[str, MeasuredDelays]:
    """The time from each frame of one identifier to the next one of another, by bus.

    A frame that is followed by its like first was lost.

    Args:
        file: output of ``candump -L`` or ``candump -t a``.
        request: an identifier in hexadecimal.
        answer: likewise.
        interface: the only bus to read, as ``can0``; by default all that have both frames.
    """
    try:
        wanted = {int(request, 16): True, int(answer, 16): False}
    except ValueError as error:
        allowed = "must be CAN identifiers in hexadecimal"
        raise ScenarioError(f"--from {request} --to {answer}: {allowed}") from error
    buses: dict[str, _Bus] = {}
    for line in _lines(file, "candump"):
        found = _CAN_LOG.search(line)
        is_request = None if found is None else wanted.get(int(found[3], 16))
        if found is not None and is_request is not None:
            buses.setdefault(found[2], _Bus([], [])).add(float(found[1]), is_request=is_request)
    if interface is not None and interface not in buses:
        on = f": these frames are on {', '.join(buses)}" if buses else ""
        raise ScenarioError(f"{file}: --interface {interface}: has no frame {request}{on}")
    if interface is not None:
        buses = {interface: buses[interface]}
    if not any(bus.sent_s for bus in buses.values()):
        raise ScenarioError(f"{file}: does not contain frame {request} in the format of candump")
    answered = {name: bus for name, bus in buses.items() if not np.isnan(bus.delays_ms).all()}
    if not answered:
        on = ", ".join(f"{'requests' if bus.sent_s else 'answers'} on {name}"
                       for name, bus in buses.items())  # fmt: skip
        raise ScenarioError(f"{file}: no frame {request} is followed by {answer} on its bus: {on}")
    return {
        name: MeasuredDelays(np.array(bus.sent_s), np.array(bus.delays_ms))
        for name, bus in answered.items()
    }


class _Bus(NamedTuple):
    """Requests of one bus, and how long their answers took; NaN for none."""

    sent_s: list[float]
    delays_ms: list[float]

    def add(self, time_s: float, *, is_request: bool) -> None:
        if is_request:
            self.sent_s.append(time_s)
            self.delays_ms.append(float("nan"))
        elif self.delays_ms and np.isnan(self.delays_ms[-1]):
            self.delays_ms[-1] = 1e3 * (time_s - self.sent_s[-1])


def from_csv(
    file: Path, sent: str, received: str | None, delay: str | None, units: Mapping[str, str]
) -> MeasuredDelays:
    """Two columns of a CSV file: when messages were sent, and received or how long they took.

    Args:
        file: its first line has the names.
        sent: column of the times of sending.
        received: column of the times of reception; empty cells were lost.
        delay: column of delays, in place of `received`; `ACK_ROUND_TRIP` is of the ACKs alone.
        units: of each of these columns.
    """
    end_name = str(received or delay)
    try:
        columns = read_columns(file, [sent, end_name], None)
        no_time = ~np.isfinite(columns.values[sent])
        columns.refuse_where(no_time, sent, "must be a time in each row")
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    start_ms, end_ms = (columns.values[name] * UNITS_MS[units[name]] for name in (sent, end_name))
    if delay == ACK_ROUND_TRIP:
        found = round_trips.of_acks(start_ms / 1e3, end_ms / 1e3)
        return MeasuredDelays(found.sent_s, found.round_trips_ms)
    order = np.argsort(start_ms, kind="stable")
    delays_ms = end_ms - start_ms if received else end_ms
    return MeasuredDelays(start_ms[order] / 1e3, delays_ms[order])


def from_mcap(file: Path, topic: str, answer: str | None) -> MeasuredDelays:
    """Return the delays of messages in an MCAP file, by the stamps in their headers.

    Args:
        file: with messages in CDR that begin with a ROS header.
        topic: of the messages; each took from its stamp to when it was logged.
        answer: a topic whose messages carry the same stamps: each took from when the one was
            logged to when the other was. A message that is not answered was lost.
    """
    logged: dict[str, dict[int, int]] = {name: {} for name in (topic, answer or topic)}
    with opened(file) as recording:
        for message in recording.messages(topic, answer):
            stamp_ns = stamp_of(message.data)
            if message.topic in logged and stamp_ns is not None:
                times_ns = logged[message.topic]
                first_ns = times_ns.get(stamp_ns, message.logged_ns)
                times_ns[stamp_ns] = min(message.logged_ns, first_ns)
    for name, found in logged.items():
        if not found:
            topics = sorted(recording.topics)
            hint = did_you_mean(name, topics)
            raise ScenarioError(
                f"{file}: no stamps on {name}; topics are {', '.join(topics)}{hint}"
            )
    stamps = np.array(sorted(logged[topic]), dtype=np.int64)
    ends = [logged[answer or topic].get(int(stamp)) for stamp in stamps]
    starts = np.array([logged[topic][int(s)] for s in stamps]) if answer else stamps
    delays_ms = [
        float("nan") if end is None else (end - int(start)) / 1e6
        for start, end in zip(starts, ends, strict=True)
    ]
    return MeasuredDelays((starts - starts[0]) / 1e9, np.array(delays_ms))


def _lines(file: Path, program: str) -> list[str]:
    try:
        text = read_text(file, MOST_BYTES)
        refuse_foreign(file, text.encode(), program)
    except OSError as error:
        raise ScenarioError(f"{file}: cannot be read: {error}") from error
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    return text.splitlines()
