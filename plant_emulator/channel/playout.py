"""The play-out buffer: jitter becomes constant delay, by the plant's clock alone."""

from __future__ import annotations

import heapq
from collections import Counter
from typing import Any

import numpy as np

from bus_schema.arrays import percentiles
from plant_emulator.channel.channel import NEVER_NS, Channel, TransportStatistics
from plant_emulator.command_gate import Command


class ArrivalTimes:
    """Counts of commands that arrived at a play-out buffer.

    Attributes:
        longest_ns: longest time from a stamp to the arrival of its command, until it is taken.
    """

    def __init__(self) -> None:
        self.longest_ns = -1
        self._late = self._late_now = self._late_in_a_row = 0
        self._arrivals_us: Counter[int] = Counter()
        self._playouts_us: Counter[int] = Counter()
        self._least_slack_ns = NEVER_NS

    def note(self, arrival_ns: int, playout_ns: int) -> None:
        """Count a command that arrived this long after its stamp, and acts no earlier than that."""
        self.longest_ns = max(self.longest_ns, arrival_ns)
        self._arrivals_us[arrival_ns // 1000] += 1
        self._playouts_us[playout_ns // 1000] += 1
        self._least_slack_ns = min(self._least_slack_ns, playout_ns - arrival_ns)
        is_late = arrival_ns > playout_ns
        self._late += is_late
        self._late_now = self._late_now + 1 if is_late else 0
        self._late_in_a_row = max(self._late_in_a_row, self._late_now)

    def summary(self) -> dict[str, Any]:
        """Return play-out, arrivals and slack in ms, and how many commands came late."""
        return {
            "horizon_ms": _percentiles_ms(self._playouts_us),
            "arrival_ms": _percentiles_ms(self._arrivals_us),
            "least_slack_ms": 1e-6 * self._least_slack_ns if self._arrivals_us else None,
            "late": self._late,
            "late_in_a_row": self._late_in_a_row,
        }


def _percentiles_ms(counts: Counter[int]) -> dict[str, float | None]:
    values = np.array(list(counts)) / 1000
    return percentiles(values, np.array(list(counts.values())))


class PlayoutBuffer:
    """A channel of commands followed by a play-out buffer.

    A command that answers the state stamped t comes out at t + play-out, or when it arrives if
    that is later. A command may bring a play-out time of its own.

    Args:
        channel: the channel.
        playout_ns: time from the stamp to the torque, for commands without one.

    Attributes:
        next_due_ns: no command comes out before this instant.
        mean_delay_ns: mean delay of the channel.
    """

    def __init__(self, channel: Channel[Command], playout_ns: int) -> None:
        self._arrivals = ArrivalTimes()
        self._channel, self._playout_ns = channel, playout_ns
        self._waiting: list[tuple[int, int, int, Command]] = []
        self._arrived = 0
        self.next_due_ns = NEVER_NS
        self.mean_delay_ns = channel.mean_delay_ns

    def send(self, command: Command, now_ns: int, size_bytes: int) -> None:
        """Send `command`, as `Channel.send` does."""
        self._channel.send(command, now_ns, size_bytes)
        self._find_next()

    def take_due(self, now_ns: int) -> list[tuple[int, Command]]:
        """Return all commands to be delivered until `now_ns` and their times, in that order."""
        for arrival_ns, command in self._channel.take_due(now_ns):
            playout_ns = command.acts_after_ns or self._playout_ns
            self._arrivals.note(arrival_ns - command.stamp_ns, playout_ns)
            out_ns = max(arrival_ns, command.stamp_ns + playout_ns)
            entry = (out_ns, command.stamp_ns, self._arrived, command)
            heapq.heappush(self._waiting, entry)
            self._arrived += 1
        due = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            out_ns, _, _, command = heapq.heappop(self._waiting)
            due.append((out_ns, command))
        self._find_next()
        return due

    def take_longest_arrival(self) -> int:
        """Return the longest time from a stamp to an arrival since the last call, -1 for none."""
        longest_ns, self._arrivals.longest_ns = self._arrivals.longest_ns, -1
        return longest_ns

    def report(self) -> dict[str, Any]:
        """Return the section ``playout`` of ``summary.json``."""
        return self._arrivals.summary()

    def statistics(self) -> TransportStatistics:
        """Counts of the channel; the buffer loses no command."""
        return self._channel.statistics()

    def _find_next(self) -> None:
        out_ns = self._waiting[0][0] if self._waiting else NEVER_NS
        self.next_due_ns = min(self._channel.next_due_ns, out_ns)
