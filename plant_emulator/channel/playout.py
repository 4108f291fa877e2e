"""The play-out buffer: jitter becomes constant delay, by the plant's clock alone."""

from __future__ import annotations

import heapq

from plant_emulator.channel.channel import NEVER_NS, Channel, TransportStatistics
from plant_emulator.command_gate import Command


class PlayoutBuffer:
    """A channel of commands followed by a play-out buffer.

    A command that answers the state stamped t comes out at t + play-out, or when it arrives if
    that is later.

    Args:
        channel: the channel.
        playout_ns: time from the stamp to the torque.

    Attributes:
        next_due_ns: no command comes out before this instant.
        mean_delay_ns: mean delay of the channel.
    """

    def __init__(self, channel: Channel[Command], playout_ns: int) -> None:
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
            out_ns = max(arrival_ns, command.stamp_ns + self._playout_ns)
            entry = (out_ns, command.stamp_ns, self._arrived, command)
            heapq.heappush(self._waiting, entry)
            self._arrived += 1
        due = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            out_ns, _, _, command = heapq.heappop(self._waiting)
            due.append((out_ns, command))
        self._find_next()
        return due

    def statistics(self) -> TransportStatistics:
        """Counts of the channel; the buffer loses no command."""
        return self._channel.statistics()

    def _find_next(self) -> None:
        out_ns = self._waiting[0][0] if self._waiting else NEVER_NS
        self.next_due_ns = min(self._channel.next_due_ns, out_ns)
