"""CANopen frames decoded by canopen from nothing but an EDS: no program of ours helps."""

from __future__ import annotations

import struct
from pathlib import Path

import canopen
from canopen.nmt import COMMAND_TO_STATE, NMT_STATES

NMT, SYNC, EMCY, SDO_ANSWER, SDO_REQUEST, HEARTBEAT = 0x000, 0x080, 0x080, 0x580, 0x600, 0x700
_SDO = struct.Struct("<BHB")
_SDO_BYTES, _EMCY_BYTES = 8, 8
_SDO_INITIATES = {0x20, 0x40, 0x60, 0x80}
"""Command specifiers of downloads, uploads and aborts: all of them name an object."""


class EdsDecoder:
    """Decodes the frames of drives that all have one EDS, with PDOs mapped as it says."""

    def __init__(self, eds: Path, node_ids: tuple[int, ...], master_id: int) -> None:
        self._dictionary = canopen.import_od(str(eds))
        self._node_ids, self._pdos = node_ids, {}
        self._heard_from = (*node_ids, master_id)
        network = canopen.Network()
        for node_id in node_ids:
            node = network.add_node(canopen.RemoteNode(node_id, str(eds)))
            for maps in (node.tpdo, node.rpdo):
                maps.read(from_od=True)
                self._pdos |= {pdo.cob_id: pdo for pdo in maps.values() if pdo.cob_id}

    def decode(self, identifier: int, data: bytes) -> dict[str, float]:
        """Values by name.

        Raises:
            ValueError: the EDS does not explain the frame.
        """
        if identifier == NMT:
            command, node_id = data
            return {"state asked for": COMMAND_TO_STATE[command], "node": node_id}
        if identifier == SYNC and not data:
            return {}
        if (pdo := self._pdos.get(identifier)) is not None:
            return self._values(pdo, data)
        function, node_id = identifier & 0x780, identifier & 0x7F
        if function == HEARTBEAT and node_id in self._heard_from:
            (state,) = data
            return {NMT_STATES[state]: state}
        if node_id in self._node_ids:
            if function == EMCY and len(data) == _EMCY_BYTES:
                return {"error": int.from_bytes(data[:2], "little")}
            if function == SDO_ANSWER and len(data) == _SDO_BYTES:
                return self._sdo(data)
        if function == SDO_REQUEST and len(data) == _SDO_BYTES:  # also to nodes that are absent
            return self._sdo(data)
        raise ValueError(f"the EDS knows no frame {identifier:03X}#{data.hex()}")

    def _values(self, pdo: canopen.pdo.PdoMap, data: bytes) -> dict[str, float]:
        mapped = sum(variable.length for variable in pdo.map)
        if 8 * len(data) != mapped:
            raise ValueError(f"{pdo.name} has {len(data)} bytes, mapped are {mapped} bits")
        pdo.data = bytearray(data)
        return {variable.name: variable.raw for variable in pdo.map}

    def _sdo(self, data: bytes) -> dict[str, float]:
        specifier, index, subindex = _SDO.unpack_from(data)
        if specifier & 0xE0 not in _SDO_INITIATES:
            raise ValueError(f"no SDO that names an object: {data.hex()}")
        entry = self._dictionary.get_variable(index, subindex)
        if entry is None:
            raise ValueError(f"no object 0x{index:04X}:{subindex}")
        return {entry.name: int.from_bytes(data[4:], "little")}
