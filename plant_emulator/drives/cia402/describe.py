"""Describes CANopen frames in words, with the dictionary's names and the active mapping."""

from __future__ import annotations

from bus_schema.can.frame import CanFrame
from plant_emulator.drives.cia402.errors import ErrorCode
from plant_emulator.drives.cia402.network_state import HEARTBEAT, NmtCommand, NmtState
from plant_emulator.drives.cia402.node import SDO_BYTES, DriveNode
from plant_emulator.drives.cia402.pdo import Pdo
from plant_emulator.drives.cia402.process_data import ProcessData

_EMERGENCY_BYTES = 3
_DOWNLOAD, _UPLOAD, _DONE, _ABORT = 0x20, 0x40, 0x60, 0x80
_REQUESTS = {_DOWNLOAD: "download request", _UPLOAD: "upload request", _ABORT: "abort"}
_ANSWERS = {_DONE: "download done", _UPLOAD: "upload response", _ABORT: "abort"}
"""SDO frames that name an object; all others are segments and blocks."""


def describe(frame: CanFrame, node: DriveNode, process_data: ProcessData) -> str | None:
    """Describe a frame in words; None if it does not concern the node."""
    identifier, data = frame.identifier, frame.data
    if identifier == 0:
        return _network(data)
    if identifier == process_data.sync_identifier:
        return "SYNC"
    if identifier == node.emcy.cob_id and len(data) >= _EMERGENCY_BYTES:
        code = int.from_bytes(data[:2], "little")
        return f"node {node.node_id} EMCY {_name(code)}, register {data[2]}"
    if identifier == HEARTBEAT + node.node_id and len(data) == 1:
        state = NmtState(data[0]).name if data[0] in list(NmtState) else data[0]
        return f"node {node.node_id} heartbeat {state}"
    if identifier in (node.sdo.rx_cobid, node.sdo.tx_cobid):
        return _sdo(data, node, is_request=identifier == node.sdo.rx_cobid)
    for direction, pdo in (
        ("RPDO", process_data.received_by().get(identifier)),
        ("TPDO", process_data.sending(identifier)),
    ):
        if pdo is not None:
            asked = " asked for" if frame.is_remote else _values(pdo, data, node)
            return f"node {node.node_id} {direction}{asked}"
    return None


def _network(data: bytes) -> str:
    if len(data) != 2 or data[0] not in list(NmtCommand):
        return f"NMT {data.hex(' ')}"
    nodes = f"node {data[1]}" if data[1] else "all nodes"
    return f"NMT {NmtCommand(data[0]).name} {nodes}"


def _name(code: int) -> str:
    known = ErrorCode(code).name if code in list(ErrorCode) else "unknown"
    return f"0x{code:04X} {known}"


def _sdo(data: bytes, node: DriveNode, *, is_request: bool) -> str:
    kind = data[0] & 0xE0 if len(data) == SDO_BYTES else None
    words = (_REQUESTS if is_request else _ANSWERS).get(kind or 0)
    if words is None:
        return f"node {node.node_id} SDO {data.hex(' ')}"
    index, subindex = int.from_bytes(data[1:3], "little"), data[3]
    entry = node.object_dictionary.indices.get(index)
    name = "(no such object)" if entry is None else entry.name
    text = f"node {node.node_id} SDO {words} 0x{index:04X}:{subindex:02X} {name}"
    has_value = kind != (_UPLOAD if is_request else _DONE)
    return text + f" 0x{int.from_bytes(data[4:], 'little'):X}" * has_value


def _values(pdo: Pdo, data: bytes, node: DriveNode) -> str:
    if len(data) != pdo.length:
        return f" {data.hex(' ')} (has {len(data)} bytes, mapped are {pdo.length})"
    parts, start = [], 0
    for index, subindex, bits in pdo.entries:
        variable = node.find(index, subindex)
        value = int(variable.decode_raw(data[start : start + bits // 8]))
        is_word = index in (0x6040, 0x6041)
        parts.append(f"{variable.name} {f'0x{value:04X}' if is_word else value}")
        start += bits // 8
    return " " + ", ".join(parts)
