"""NMT state of a node, its boot-up and heartbeats (CiA 301, 7.2.8)."""

from __future__ import annotations

from enum import IntEnum

from canopen.sdo.exceptions import SdoAbortedError

from bus_schema.can.frame import CanFrame
from plant_emulator.drives.cia402.node import Abort, DriveNode
from plant_emulator.drives.drive import Cycle, Send

HEARTBEAT = 0x700
_MS = 1_000_000
_CONSUMED = (1, 2)
_MOST_NODES = 127


class NmtState(IntEnum):
    """States, as heartbeats report them."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Commands of the NMT master."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


_STATE_AFTER = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


class NetworkState:
    """NMT state of a node, its heartbeat, and whose heartbeats it waits for.

    Args:
        node: the node.
        send: takes the frames it sends.

    Attributes:
        state: NMT state.
        watched: time in ns within which a heartbeat of each watched node is due.
    """

    def __init__(self, node: DriveNode, send: Send) -> None:
        self._node, self._send = node, send
        self.state = NmtState.INITIALISING
        self.watched: dict[int, int] = {}
        self._heartbeats = Cycle(0)
        self._received_ns: dict[int, int] = {}
        self._lost: set[int] = set()
        node.writers[0x1016] = self._check_consumed
        node.writers[0x1017] = self._on_period

    @property
    def has_sdo(self) -> bool:
        """Whether SDOs and emergencies are served in this state."""
        return self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)

    def boot(self) -> None:
        """Send the boot-up message; from now on the node is pre-operational."""
        self._report()
        self.state = NmtState.PRE_OPERATIONAL
        self._received_ns.clear()
        self._lost.clear()
        self._on_period(0, self._node.values[0x1017_00])

    def note_set_up(self) -> None:
        """Read object 0x1016 again, which may have changed."""
        entries = [self._node.values[0x1016_00 + subindex] for subindex in _CONSUMED]
        self.watched = dict(_consumer(entry) for entry in entries if _is_used(entry))

    def obey(self, command: NmtCommand) -> None:
        """Change the state; the drive itself does resets."""
        self.state = _STATE_AFTER[command]

    def note_heartbeat(self, node_id: int) -> bool:
        """Note a heartbeat of a watched node. Returns whether it was the last one missing."""
        self._received_ns[node_id] = self._node.now_ns
        was_lost = node_id in self._lost
        self._lost.discard(node_id)
        return was_lost and not self._lost

    def advance(self) -> bool:
        """Send a heartbeat if one is due. Returns whether an expected one has just failed."""
        now_ns = self._node.now_ns
        if self._heartbeats.is_due(now_ns):
            self._report()
        has_failed = False
        for node_id, time_ns in self.watched.items():
            is_overdue = now_ns - self._received_ns.get(node_id, now_ns) > time_ns
            if is_overdue and node_id not in self._lost:
                self._lost.add(node_id)
                has_failed = True
        return has_failed

    def _report(self) -> None:
        self._send(CanFrame(HEARTBEAT + self._node.node_id, bytes([self.state])))

    def _on_period(self, _subindex: int, value: int) -> None:
        self._heartbeats = Cycle(value * _MS, self._node.now_ns + value * _MS)

    def _check_consumed(self, subindex: int, value: int) -> None:
        """Refuse two entries for the same node (CiA 301, 7.5.2.18)."""
        others = [self._node.values[0x1016_00 + other] for other in _CONSUMED if other != subindex]
        nodes = [_consumer(other)[0] for other in others if _is_used(other)]
        if _is_used(value) and _consumer(value)[0] in nodes:
            raise SdoAbortedError(Abort.INCOMPATIBLE)
        self._received_ns.pop(_consumer(value)[0], None)


def _consumer(entry: int) -> tuple[int, int]:
    """Node and time in ns of an entry of object 0x1016."""
    return entry >> 16 & 0xFF, (entry & 0xFFFF) * _MS


def _is_used(entry: int) -> bool:
    node_id, time_ns = _consumer(entry)
    return time_ns > 0 and 0 < node_id <= _MOST_NODES
