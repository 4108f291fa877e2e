"""Errors of a drive: emergency frames, error register and error history (CiA 301, 7.2.7, 7.5.2)."""

from __future__ import annotations

from enum import IntEnum

from canopen.sdo.exceptions import SdoAbortedError

from plant_emulator.drives.cia402.network_state import NetworkState
from plant_emulator.drives.cia402.node import Abort, DriveNode

_HISTORY = 8
_NOT_VALID = 1 << 31
_GENERIC_BIT = 0x01
_CLASS_BITS = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x8: 0x10}


class ErrorCode(IntEnum):
    """Emergency error codes, those of object 0x603F (CiA 301, table 26; CiA 402-2, annex)."""

    NONE = 0x0000
    SHORT_CIRCUIT = 0x2320
    OVER_TEMPERATURE = 0x4310
    ENCODER = 0x7305
    STOPPED = 0x8100
    HEARTBEAT_LOST = 0x8130
    BUS_OFF = 0x8140
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250
    FOLLOWING_ERROR = 0x8611


SENTENCES = {
    ErrorCode.SHORT_CIRCUIT: "short circuit in the power stage",
    ErrorCode.OVER_TEMPERATURE: "over-temperature",
    ErrorCode.ENCODER: "encoder cannot be read",
    ErrorCode.STOPPED: "stopped by the network master",
    ErrorCode.HEARTBEAT_LOST: "heartbeat of the master lost",
    ErrorCode.BUS_OFF: "bus-off",
    ErrorCode.RPDO_TIMEOUT: "no RPDO within its event time",
    ErrorCode.FOLLOWING_ERROR: "following error",
}


class ErrorLog:
    """The present errors, and those already reported.

    Args:
        node: whose errors they are.
        network: whether its state allows emergency frames.

    Attributes:
        fault: object 0x603F, the error that made the automaton fault.
    """

    def __init__(self, node: DriveNode, network: NetworkState) -> None:
        self._node, self._network = node, network
        self.fault = ErrorCode.NONE
        self._lasting: dict[ErrorCode, bool] = {}
        self._history: list[int] = []
        node.readers[0x1001] = lambda _: self.register
        node.readers[0x1003] = self._read_history
        node.readers[0x603F] = lambda _: self.fault
        node.writers[0x1003] = self._clear_history
        node.writers[0x1014] = lambda _, value: check_identifier(value, node.values[0x1014_00])

    @property
    def any(self) -> bool:
        """Whether there is an error."""
        return bool(self._lasting)

    @property
    def register(self) -> int:
        """The error register, object 0x1001."""
        bits = _GENERIC_BIT if self._lasting else 0
        for code in self._lasting:
            bits |= _CLASS_BITS.get(code >> 12, 0)
        return bits

    def note(self, code: ErrorCode, *, lasting: bool = False) -> None:
        """Add an error. `lasting`: its cause remains until `cause_gone`."""
        if code in self._lasting:
            self._lasting[code] = lasting
            return
        self._lasting[code] = lasting
        self._history = [code, *self._history][:_HISTORY]
        self._emit(code)

    def cause_gone(self, code: ErrorCode) -> None:
        """Note that the cause of an error is gone, so that it can be reset."""
        if code in self._lasting:
            self._lasting[code] = False

    def clear(self, code: ErrorCode) -> None:
        """Remove an error that ended by itself."""
        if self._lasting.pop(code, None) is not None:
            self._emit(ErrorCode.NONE)

    def reset(self) -> bool:
        """Reset all errors. Returns false, without effect, while a cause remains."""
        if any(self._lasting.values()):
            return False
        if self._lasting:
            self._lasting.clear()
            self._emit(ErrorCode.NONE)
        self.fault = ErrorCode.NONE
        return True

    def forget(self) -> None:
        """Clear errors and history, as at power-on."""
        self._lasting.clear()
        self._history = []
        self.fault = ErrorCode.NONE

    def _emit(self, code: ErrorCode) -> None:
        identifier = self._node.values[0x1014_00]
        if self._network.has_sdo and not identifier & _NOT_VALID:
            self._node.emcy.cob_id = identifier
            self._node.emcy.send(code, self.register)

    def _read_history(self, subindex: int) -> int:
        if subindex == 0:
            return len(self._history)
        if subindex > len(self._history):
            raise SdoAbortedError(Abort.NO_DATA)
        return self._history[subindex - 1]

    def _clear_history(self, _subindex: int, value: int) -> None:
        if value != 0:
            raise SdoAbortedError(Abort.INVALID_VALUE)
        self._history = []


def check_identifier(value: int, present: int) -> None:
    """Check what is written to a COB-ID object (CiA 301, 7.3.5 and 7.5.2).

    Args:
        value: bit 31: not valid; bit 29: extended frame, which these drives do not have; bits 0 to
            10: the identifier, which may not change while it is valid.
        present: the object's value so far.

    Raises:
        SdoAbortedError: it cannot be.
    """
    is_valid = not value & _NOT_VALID
    # CiA 301 (table 40) keeps some identifiers for something else.
    is_kept = any(first <= value & _IDENTIFIER <= last for first, last in _RESTRICTED)
    if value & _BITS_11_TO_29 or (is_valid and is_kept):
        raise SdoAbortedError(Abort.INVALID_VALUE)
    is_changed = (value ^ present) & _IDENTIFIER
    if is_changed and is_valid and not present & _NOT_VALID:
        raise SdoAbortedError(Abort.INVALID_VALUE)


_IDENTIFIER = 0x7FF
_BITS_11_TO_29 = 0x3FFFF800
_RESTRICTED = (
    (0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF),
)  # fmt: skip
