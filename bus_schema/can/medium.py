"""The medium of an emulated CAN bus: one frame at a time, the lowest identifier first.

It keeps time for frames that some software carries at once: each gets the instants at which it
would have won arbitration and been through on a wire, on the plant's clock. It delays nothing: a
frame that takes tenths of a millisecond on the wire is answered within the same tick, whatever
carries it, so a run gives the same bits over every interface. What a real wire would have added is
reported.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any

from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import WireBits, arbitration_key, classical_bits, wire_bits
from bus_schema.link.can_configuration import CanConfiguration

_ERROR_FLAG_BITS = (6, 12)
_ERROR_DELIMITER_AND_SPACE_BITS = 8 + 3
_LOAD_WINDOW_NS = 100_000_000
_MOST_NAMES = 1000
_OTHERS, _NOBODY = -1, -2


class CanMedium:
    """Times and statistics of one bus.

    Args:
        configuration: bit rates, and what goes wrong.
        seed: seed of the error frames.

    Attributes:
        free_ns: instant from which on the bus is idle.
        error_frames: frames that were destroyed and sent again.
        worst_latency_ns: longest time from a frame being ready to its end on the wire.
    """

    def __init__(self, configuration: CanConfiguration, seed: int) -> None:
        self._bitrate = configuration.bitrate
        self._data_bitrate = configuration.data_bitrate or configuration.bitrate
        self._error_probability = configuration.faults.frame_error_probability
        self._random = random.Random(seed)
        self._durations_ns: dict[int, int] = {}
        self._counts: dict[int, int] = {}
        self._busy_ns = 0
        self._window, self._window_busy_ns, self._peak_busy_ns = 0, 0, 0
        self._worst_name = _NOBODY
        self._start_ns = 0
        self.free_ns = 0
        self.error_frames = 0
        self.worst_latency_ns = 0
        for is_fd in (False, True):
            # Compiles what counts bits: in the midst of a run that takes longer than a busy
            # machine's time-outs.
            wire_bits(CanFrame(0, is_fd=is_fd))

    def transmit(self, frames: Sequence[CanFrame], ready_ns: int) -> list[tuple[int, CanFrame]]:
        """Send frames that are ready at the same instant, by nodes that arbitrate.

        Returns:
            The frames in the order in which they win, with the instants at which they are through,
            counted from when the bus came up.
        """
        passed = []
        in_order = sorted(frames, key=arbitration_key) if len(frames) > 1 else frames
        for frame in in_order:
            start_ns = max(ready_ns, self.free_ns)
            self.free_ns = start_ns + self._time_on_wire_ns(frame)
            self._note(_name(frame), start_ns, self.free_ns - ready_ns)
            passed.append((self._start_ns + self.free_ns, frame))
        return passed

    def start_counting(self) -> None:
        """The run begins: time is 0 again, and what came before does not count."""
        self._start_ns += self.free_ns
        self._counts.clear()
        self._window = self._window_busy_ns = self._peak_busy_ns = 0
        self._busy_ns = self.free_ns = self.error_frames = self.worst_latency_ns = 0

    def summary(self, duration_ns: int) -> dict[str, Any]:
        """Load, latency and counts over a run of this length, ready for JSON."""
        return {
            "bitrate": self._bitrate,
            "load": self._busy_ns / duration_ns if duration_ns else None,
            "peak_load_100_ms": max(self._peak_busy_ns, self._window_busy_ns) / _LOAD_WINDOW_NS,
            "worst_latency_us": self.worst_latency_ns * 1e-3,
            "worst_latency_identifier": _text(self._worst_name),
            "frames": sum(self._counts.values()),
            "frames_by_identifier": dict(
                sorted((_text(name), count) for name, count in self._counts.items())
            ),
            "error_frames": self.error_frames,
        }

    def _time_on_wire_ns(self, frame: CanFrame) -> int:
        """With all that is destroyed on the way: error frames cut a frame off at a random bit."""
        duration_ns = total_ns = self._duration_ns(frame)
        while self._error_probability and self._random.random() < self._error_probability:
            self.error_frames += 1
            flag = self._random.randint(*_ERROR_FLAG_BITS)
            wasted = self._random.random() * duration_ns
            after = 1e9 * (flag + _ERROR_DELIMITER_AND_SPACE_BITS) / self._bitrate
            total_ns += math.ceil(wasted + after)
        return total_ns

    def _duration_ns(self, frame: CanFrame) -> int:
        """How long the frame is on the wire if nothing happens to it."""
        if frame.is_fd:
            return wire_bits(frame).duration_ns(self._bitrate, self._data_bitrate)
        bits = classical_bits(frame)
        duration_ns = self._durations_ns.get(bits)
        if duration_ns is None:
            duration_ns = WireBits(bits, 0).duration_ns(self._bitrate, self._data_bitrate)
            self._durations_ns[bits] = duration_ns
        return duration_ns

    def _note(self, name: int, start_ns: int, latency_ns: int) -> None:
        if name not in self._counts:
            if len(self._counts) >= _MOST_NAMES:
                name = _OTHERS  # a flood of them fills counters, not memory
            self._counts.setdefault(name, 0)
        self._counts[name] += 1
        busy_ns = self.free_ns - start_ns
        self._busy_ns += busy_ns
        window = start_ns // _LOAD_WINDOW_NS
        if window != self._window:
            self._peak_busy_ns = max(self._peak_busy_ns, self._window_busy_ns)
            self._window, self._window_busy_ns = window, 0
        self._window_busy_ns += busy_ns
        if latency_ns > self.worst_latency_ns:
            self.worst_latency_ns, self._worst_name = latency_ns, name


def _name(frame: CanFrame) -> int:
    """Identifier and format of a frame in one number: texts are made when they are asked for."""
    return frame.identifier << 1 | frame.is_extended


def _text(name: int) -> str:
    if name < 0:
        return "" if name == _NOBODY else "others"
    return f"{name >> 1:0{8 if name & 1 else 3}X}"
