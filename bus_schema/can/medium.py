"""The medium of an emulated CAN bus: one frame at a time, the lowest identifier first.

It keeps time for frames that some software carries at once: each gets the instants at which it
would have won arbitration and ended on a wire, on the plant's clock. It delays nothing: a frame
that takes tenths of a millisecond on the wire is answered within the same tick, so a run gives the
same bits over every interface. The delay of a real wire is reported. It is computed for many
frames at once, as no node waits for it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import FrameTable, count_bits, frame_table
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.runtime.randomness import plain_generator

_ERROR_FLAG_BITS = (6, 12)
_ERROR_DELIMITER_AND_SPACE_BITS = 8 + 3
_LOAD_WINDOW_NS = 100_000_000
_MOST_NAMES = 1000
_OTHERS, _NOBODY = -1, -2
_MOST_WAITING = 1024
_ERROR_FLAG, _IDENTIFIER = 0x2000_0000, 0x1FFF_FFFF
_MOST_BYTES = 64


class CandumpLog:
    """A file of frames as ``candump -L`` writes them, which every CAN tool reads.

    Its lines are ``(seconds.microseconds) channel identifier#data``. python-can's own writer makes
    the same, at several times the cost of each.

    Args:
        path: the file; overwritten.
        channel: name of the bus.
    """

    def __init__(self, path: Path, channel: str) -> None:
        self._file = path.open("w", encoding="utf-8")
        self._channel = channel

    def write(self, times_ns: NDArray[np.int64], frames: Iterable[CanFrame]) -> None:
        """Append frames that were on the bus at these times, shape (frames,)."""
        lines = []
        times_us = (times_ns // 1000).tolist()
        for time_us, frame in zip(times_us, frames, strict=True):
            identifier, data, is_extended, is_remote, is_error, is_fd = frame
            number = identifier & _IDENTIFIER | is_error * _ERROR_FLAG
            digits = 8 if is_extended or is_error else 3
            flags = "#1" if is_fd else ""  # the bit rate was switched
            content = "R" if is_remote else data[:_MOST_BYTES].hex().upper()
            time = f"{time_us // 1_000_000}.{time_us % 1_000_000:06}"
            lines.append(f"({time}) {self._channel} {number:0{digits}X}#{flags}{content}\n")
        self._file.write("".join(lines))

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class CanMedium:
    """Times and statistics of one bus.

    Args:
        configuration: bit rates, and what goes wrong.
        seed: seed of the error frames.
        log: takes every frame, with the instant at which it is through, counted from when the bus
            came up; None for no log.

    Attributes, as of the frames that are settled:
        free_ns: instant from which on the bus is idle.
        error_frames: frames that were destroyed and sent again.
        worst_latency_ns: longest time from a frame being ready to its end on the wire.
    """

    def __init__(
        self, configuration: CanConfiguration, seed: int, log: CandumpLog | None = None
    ) -> None:
        self._bitrate = configuration.bitrate
        self._data_bitrate = configuration.data_bitrate or configuration.bitrate
        self._error_probability = configuration.faults.frame_error_probability
        self._random = plain_generator(seed)
        self._log = log
        self._frames: list[CanFrame] = []
        self._ready_ns: list[int] = []
        self._together: list[int] = []
        self._counts: Counter[int] = Counter()
        self._busy_ns = 0
        self._window, self._window_busy_ns, self._peak_busy_ns = 0, 0, 0
        self._worst_name = _NOBODY
        self._start_ns = 0
        self.free_ns = 0
        self.error_frames = 0
        self.worst_latency_ns = 0
        # Compile the bit counter now: during a run, it would exceed the timeouts of a busy machine.
        count_bits(frame_table([CanFrame(0)]))

    def carry(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        """Send frames that become ready at the same instant, by nodes that arbitrate.

        That is `now_ns`, or when all that was sent before is through, if that is later.
        """
        if frames:
            self._frames += frames
            self._ready_ns.append(now_ns)
            self._together.append(len(frames))
            if len(self._frames) >= _MOST_WAITING:
                self.settle()

    def catch_up(self, at_least: int = 128) -> None:
        """Settle, if at least so many frames are pending; call it while no node waits."""
        if len(self._frames) >= at_least:
            self.settle()

    def settle(self) -> None:
        """Compute the bus times of the pending frames, count and log them."""
        if not self._frames:
            return
        frames, ready_ns = self._frames, np.array(self._ready_ns, dtype=np.int64)
        table = frame_table(frames)
        sizes = np.array(self._together)
        self._frames, self._ready_ns, self._together = [], [], []
        bits, group = count_bits(table), np.repeat(np.arange(sizes.size), sizes)
        order = np.lexsort((bits.arbitration, group))
        seconds = bits.nominal / self._bitrate + bits.fast / self._data_bitrate
        table, durations_ns = table.take(order), np.rint(1e9 * seconds).astype(np.int64)[order]
        if self._error_probability:
            durations_ns = np.array([self._with_errors_ns(each) for each in durations_ns.tolist()])
        ends_ns = self._ends_ns(ready_ns[group], durations_ns)
        starts_ns = ends_ns - durations_ns
        first = np.cumsum(sizes) - sizes
        if self._log is not None:
            in_order = [frames[place] for place in order.tolist()]
            self._log.write(self._start_ns + ends_ns, in_order)
        self._note_load(starts_ns, durations_ns)
        self._note_frames(table, ends_ns - starts_ns[first][group])
        self.free_ns = int(ends_ns[-1])

    def start_counting(self) -> None:
        """Begin the run: time is 0 again, and earlier frames do not count."""
        self.settle()
        self._start_ns += self.free_ns
        self._counts.clear()
        self._window = self._window_busy_ns = self._peak_busy_ns = 0
        self._busy_ns = self.free_ns = self.error_frames = self.worst_latency_ns = 0

    def summary(self, duration_ns: int) -> dict[str, Any]:
        """Load, latency and counts over a run of this length, ready for JSON."""
        self.settle()
        return {
            "bitrate": self._bitrate,
            "load": self._busy_ns / duration_ns if duration_ns else None,
            "peak_load_100_ms": self._peak_busy_ns / _LOAD_WINDOW_NS,
            "worst_latency_us": self.worst_latency_ns * 1e-3,
            "worst_latency_identifier": _text(self._worst_name),
            "frames": sum(self._counts.values()),
            "frames_by_identifier": dict(
                sorted((_text(name), count) for name, count in self._counts.items())
            ),
            "error_frames": self.error_frames,
        }

    def close(self) -> None:
        """Settle, and finish the log."""
        self.settle()
        if self._log is not None:
            self._log.close()

    def _ends_ns(
        self, ready_ns: NDArray[np.int64], durations_ns: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the end of each frame: it begins when it is ready and all before it have ended."""
        through_ns = np.cumsum(durations_ns)
        idle_ns = np.maximum.accumulate(ready_ns - (through_ns - durations_ns))
        return np.asarray(through_ns + np.maximum(idle_ns, self.free_ns))

    def _with_errors_ns(self, duration_ns: int) -> int:
        """Add the repetitions: error frames cut a frame off at a random bit."""
        total_ns = duration_ns
        while self._error_probability and self._random.random() < self._error_probability:
            self.error_frames += 1
            flag = self._random.randint(*_ERROR_FLAG_BITS)
            wasted = self._random.random() * duration_ns
            after = 1e9 * (flag + _ERROR_DELIMITER_AND_SPACE_BITS) / self._bitrate
            total_ns += math.ceil(wasted + after)
        return total_ns

    def _note_load(self, starts_ns: NDArray[np.int64], durations_ns: NDArray[np.int64]) -> None:
        """Add up how long the bus was busy in each window."""
        self._busy_ns += int(durations_ns.sum())
        windows, first = np.unique(starts_ns // _LOAD_WINDOW_NS, return_index=True)
        busy_ns = np.add.reduceat(durations_ns, first)
        if windows[0] == self._window:
            busy_ns[0] += self._window_busy_ns
        self._peak_busy_ns = max(self._peak_busy_ns, int(busy_ns.max()))
        self._window, self._window_busy_ns = int(windows[-1]), int(busy_ns[-1])

    def _note_frames(self, table: FrameTable, latencies_ns: NDArray[np.int64]) -> None:
        names = (table["identifier"] << 1 | table["is_extended"]).tolist()
        for name, count in Counter(names).items():
            self._counts[self._known(name)] += count
        worst = int(latencies_ns.argmax())
        if latencies_ns[worst] > self.worst_latency_ns:
            self.worst_latency_ns = int(latencies_ns[worst])
            self._worst_name = self._known(names[worst])

    def _known(self, name: int) -> int:
        """Return the name for counting: a flood of identifiers must not fill the memory."""
        return name if name in self._counts or len(self._counts) < _MOST_NAMES else _OTHERS


def _text(name: int) -> str:
    if name < 0:
        return "" if name == _NOBODY else "others"
    return f"{name >> 1:0{8 if name & 1 else 3}X}"
