"""Timing of process data: SYNC, events, timers (CiA 301, 7.2.2 and 7.5.2.34 to 38)."""

from __future__ import annotations

from canopen.sdo.exceptions import SdoAbortedError

from bus_schema.can.frame import CanFrame
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cia402.errors import ErrorCode, ErrorLog, check_identifier
from plant_emulator.drives.cia402.node import Abort, DriveNode
from plant_emulator.drives.cia402.pdo import Pdo
from plant_emulator.drives.drive import Send

_PDOS = 4
_PRODUCES_SYNC = 1 << 30


class ProcessData:
    """All PDOs of a drive.

    Args:
        node: whose they are.
        errors: its errors.
        send: takes the frames it sends.
        is_fd: what is sent goes in frames of CAN FD; what comes may have any format.

    Attributes:
        samplings: SYNCs on which values were sampled so far.
        sync_identifier: of SYNC.
        sent_identifiers: those of the TPDOs as they are set up now.
    """

    def __init__(self, node: DriveNode, errors: ErrorLog, send: Send, *, is_fd: bool) -> None:
        self._node, self._errors, self._send, self._is_fd = node, errors, send, is_fd
        self._received = [Pdo(node, number, is_received=True) for number in range(_PDOS)]
        self._sent = [Pdo(node, number, is_received=False) for number in range(_PDOS)]
        node.writers[0x1005] = _check_sync
        self.samplings = 0
        self.note_set_up()

    def rest(self) -> None:
        """Reset all pending and awaited data, because the node is not operational."""
        for pdo in (*self._received, *self._sent):
            pdo.rest()

    def received_by(self) -> dict[int, Pdo]:
        """The RPDOs as they are set up now, by identifier; of several with one, the first."""
        return {pdo.identifier: pdo for pdo in reversed(self._received) if pdo.is_valid}

    def note_set_up(self) -> None:
        """Read the objects of SYNC and PDOs again, which may have changed."""
        self.sync_identifier = self._node.values[0x1005_00] & 0x7FF
        for pdo in (*self._received, *self._sent):
            pdo.note_set_up()
        valid = [pdo for pdo in self._sent if pdo.is_valid]
        self.sent_identifiers = {pdo.identifier for pdo in valid}
        self._on_sync = [pdo for pdo in valid if pdo.is_synchronous]
        self._on_event = [pdo for pdo in valid if pdo.entries and not pdo.is_synchronous]
        self._awaited = [pdo for pdo in self._received if pdo.is_valid and pdo.event_ns]

    def sending(self, identifier: int) -> Pdo | None:
        """The TPDO with this identifier."""
        for pdo in self._sent:
            if pdo.identifier == identifier and pdo.is_valid:
                return pdo
        return None

    def sync(self, data: bytes) -> bool:
        """Process SYNC: apply pending data, then sample and send due data.

        Returns:
            Whether that may have changed the data of event-driven TPDOs.
        """
        has_changed = self._errors.any
        if data:
            self._errors.note(ErrorCode.SYNC_LENGTH)
            raise InvalidMessageError("sync_length", f"a SYNC has no counter here: {data!r}")
        self._errors.clear(ErrorCode.SYNC_LENGTH)
        self.samplings += 1
        for received in self._received:
            if received.data is not None:
                data, received.data = received.data, None
                has_changed = True
                _unpack(received, data)
        for sent in self._on_sync:
            self._send_on_sync(sent)
        return has_changed

    def receive(self, pdo: Pdo, data: bytes) -> None:
        """Receive data for an RPDO."""
        self._check_length(pdo, data)
        pdo.received_ns = self._node.now_ns
        if pdo.is_synchronous:
            pdo.data = data
        else:
            _unpack(pdo, data)

    def transmit(self, pdo: Pdo, data: bytes) -> None:
        """Send a TPDO."""
        pdo.data, pdo.sent_ns, pdo.syncs = data, self._node.now_ns, 0
        self._send(CanFrame(pdo.identifier, data, is_fd=self._is_fd))

    def send_events(self) -> None:
        """Send event-driven TPDOs that have changed or whose timers have run out."""
        for pdo in self._on_event:
            age_ns = self._node.now_ns - pdo.sent_ns
            if pdo.data is not None and age_ns < pdo.inhibit_ns:
                continue
            data = pdo.pack()
            if data != pdo.data or (pdo.event_ns and age_ns >= pdo.event_ns):
                self.transmit(pdo, data)

    def has_overdue(self) -> bool:
        """Whether an RPDO is overdue; each is awaited from its first arrival on."""
        overdue = False
        for pdo in self._awaited:
            if pdo.received_ns is not None and self._node.now_ns - pdo.received_ns > pdo.event_ns:
                pdo.received_ns, overdue = None, True
        return overdue

    def _send_on_sync(self, pdo: Pdo) -> None:
        pdo.syncs += 1
        if pdo.syncs < pdo.period:
            return
        data = pdo.pack()
        if pdo.period > 0 or data != pdo.data:
            self.transmit(pdo, data)

    def _check_length(self, pdo: Pdo, data: bytes) -> None:
        if len(data) < pdo.length:
            self._errors.note(ErrorCode.PDO_TOO_SHORT)
            raise InvalidMessageError("pdo_too_short", f"{len(data)} of {pdo.length} bytes")
        if len(data) > pdo.length:
            self._errors.note(ErrorCode.PDO_TOO_LONG)
            raise InvalidMessageError("pdo_too_long", f"{len(data)} for {pdo.length} bytes")
        if self._errors.any:
            self._errors.clear(ErrorCode.PDO_TOO_SHORT)
            self._errors.clear(ErrorCode.PDO_TOO_LONG)


def _check_sync(_subindex: int, value: int) -> None:
    if value & _PRODUCES_SYNC:
        raise SdoAbortedError(Abort.INVALID_VALUE)
    check_identifier(value, value)


def _unpack(pdo: Pdo, data: bytes) -> None:
    try:
        pdo.unpack(data)
    except SdoAbortedError as error:
        raise InvalidMessageError("pdo_refused", str(error)) from error
