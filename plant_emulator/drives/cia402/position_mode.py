"""Cyclic synchronous position mode (CiA 402-2, mode 8): a drive that closes its own loops.

Target and velocity offset come with every cycle, the torque offset too; the gains are objects
0x60FB (position loop) and 0x60F9 (velocity loop), whose contents the profile leaves to the maker.
"""

from __future__ import annotations

import math

from canopen.sdo.exceptions import SdoAbortedError

from bus_schema.can.cia402.codec import Cia402Settings
from plant_emulator.drives.cascade import CascadeGains, CascadeLoop, Integral
from plant_emulator.drives.cia402.node import Abort, DriveNode
from plant_emulator.drives.drive import DriveSettings, JointReading

_VELOCITY_OFFSET = 0x60B1_00
_LOWER_LIMIT, _UPPER_LIMIT = 0x607D_01, 0x607D_02
_WINDOW, _WINDOW_MS, _FAULTS = 0x6065_00, 0x6066_00, 0x2001_00
_GAINS = (0x60FB_01, 0x60F9_01, 0x60F9_02)
"""In the order of `CascadeGains`."""

_NO_WINDOW = 0xFFFF_FFFF
_INT32, _TURNOVER = (-(1 << 31), (1 << 31) - 1), 1 << 32
_LARGEST_GAIN = 0xFFFF_FFFF
_MS = 1_000_000
_MILLI = 1e-3


class PositionMode:
    """State of the mode, without the automaton.

    Until a target is written, it is the joint's position when the drive began to follow.

    Args:
        node: the drive's dictionary.
        settings: how it is commissioned.

    Attributes:
        has_following_error: the joint has been outside the window for its time.
    """

    def __init__(self, node: DriveNode, settings: DriveSettings[Cia402Settings]) -> None:
        self._node, self._settings = node, settings
        self._counts_per_rad = settings.counts_per_turn / (2.0 * math.pi)
        self._counts = 0
        self._fit()
        self.restore()
        node.readers[0x6062] = lambda _: self.demanded
        node.readers[0x60F4] = lambda _: self._error()
        node.writers[0x607A] = self._set_target
        node.writers[0x607D] = self._check_limit

    def restore(self) -> None:
        """Reset to the state before the first target."""
        self._target: int | None = None
        self.rest()

    def rest(self) -> None:
        """Note that the drive does not follow its target."""
        self._held: int | None = None
        self._integral = Integral()
        self._outside_since_ns: int | None = None
        self.has_following_error = False

    @property
    def has_followed(self) -> bool:
        """Whether the drive has had a turn to follow since it last came to rest."""
        return self._held is not None

    def measure(self, reading: JointReading) -> int:
        """Take in what the sensors show; the position in increments, as object 0x6064 has it."""
        self._counts = round(reading.position_rad * self._counts_per_rad)
        return self._actual

    @property
    def limits(self) -> tuple[int, int]:
        """The software limits, increments."""
        return self._node.values[_LOWER_LIMIT], self._node.values[_UPPER_LIMIT]

    @property
    def demanded(self) -> int:
        """Object 0x6062: the target within the software limits, increments."""
        target = self._target
        if target is None:
            target = self._actual if self._held is None else self._held
        lowest, highest = self.limits
        return min(max(target, lowest), highest)

    @property
    def is_target_limited(self) -> bool:
        """Whether the target is beyond the software limits."""
        return self._target is not None and self.demanded != self._target

    def follow(self) -> None:
        """Check the following-error window while the drive follows."""
        if self._held is None:
            self._held = self._actual
        window = self._node.values[_WINDOW]
        if window == _NO_WINDOW or abs(self._error()) <= window:
            self._outside_since_ns, self.has_following_error = None, False
            return
        if self._outside_since_ns is None:
            self._outside_since_ns = self._node.now_ns
        outside_ns = self._node.now_ns - self._outside_since_ns
        self.has_following_error = outside_ns >= self._node.values[_WINDOW_MS] * _MS

    @property
    def error_is_fault(self) -> bool:
        """Whether a following error is a fault (object 0x2001)."""
        return self.has_following_error and self._node.values[_FAULTS] == 1

    def loop(self, offset_nm: float, most_nm: float) -> CascadeLoop:
        """Return the drive's present loop.

        Args:
            offset_nm: the torque offset.
            most_nm: the torque limit in force.
        """
        # The encoder counts turns beyond 32 bits, and the target means those nearest to the joint.
        turns = self._counts - self._actual
        gains = CascadeGains(*(self._node.values[each] * _MILLI for each in _GAINS))
        return CascadeLoop(
            (self.demanded + turns) / self._counts_per_rad,
            self._node.values[_VELOCITY_OFFSET] / self._counts_per_rad,
            offset_nm, gains, 1.0 / self._counts_per_rad, math.inf, most_nm,
            self._integral,
        )  # fmt: skip

    @property
    def _actual(self) -> int:
        return _wrapped(self._counts)

    def _error(self) -> int:
        """Object 0x60F4, increments."""
        return _wrapped(self.demanded - self._actual)

    def _fit(self) -> None:
        """Objects whose defaults are this drive's own."""
        settings, fit = self._settings, self._node.fit
        limits = ((_LOWER_LIMIT, settings.lower_rad), (_UPPER_LIMIT, settings.upper_rad))
        for place, limit_rad in limits:
            if math.isfinite(limit_rad):
                counts = round(limit_rad * self._counts_per_rad)
                fit(place, min(max(counts, _INT32[0]), _INT32[1]))
        for place, gain in zip(_GAINS, settings.gains, strict=True):
            fit(place, min(round(gain / _MILLI), _LARGEST_GAIN))

    def _set_target(self, _subindex: int, value: int) -> None:
        self._target = value
        self._node.targets += 1

    def _check_limit(self, subindex: int, value: int) -> None:
        lowest, highest = self.limits
        if (value > highest) if subindex == 1 else (value < lowest):
            raise SdoAbortedError(Abort.MAXIMUM_BELOW_MINIMUM)


def _wrapped(counts: int) -> int:
    """Increments as 32 bits have them."""
    return (counts - _INT32[0]) % _TURNOVER + _INT32[0]
