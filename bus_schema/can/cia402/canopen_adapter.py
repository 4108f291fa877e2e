"""What both sides need of canopen: descriptions of devices, and a network on a bus of ours."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ObjectDictionary, ODVariable

from bus_schema.can.frame import CanFrame
from bus_schema.configuration import ConfigurationError
from bus_schema.user_files import read_bytes

_NEEDED = (
    0x1000, 0x1016, 0x1017, 0x1400, 0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071, 0x6076,
    0x608F, 0x6502,
)  # fmt: skip
"""Objects that a master must find in the description of a drive."""


class CanopenNetwork(canopen.Network):
    """canopen's network with nothing behind it but a function that takes frames."""

    def __init__(self, send: Callable[[CanFrame], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame."""
        self._send(CanFrame(can_id, bytes(data), is_remote=remote))


def object_dictionary(eds: Path | str, node_id: int) -> ObjectDictionary:
    """The objects of a node; they hold no values, so all nodes of an address can share them.

    Raises:
        Exception: whatever canopen's parser makes of a file that is no EDS.
    """
    return _parsed(str(eds), Path(eds).stat().st_mtime_ns, node_id)


def check_eds(eds: str) -> None:
    """Check the description of a drive that a scenario names.

    Raises:
        ConfigurationError: it is no EDS, or lacks an object that the master needs.
    """
    try:
        read_bytes(Path(eds))
        dictionary = canopen.import_od(eds, 1)
        for each in dictionary.values():
            for variable in (each,) if isinstance(each, ODVariable) else each.values():
                if (variable.data_type or 1) < 1:
                    raise ValueError(f"{variable.name} has data type {variable.data_type}")
    except Exception as error:  # the parser raises whatever comes its way
        allowed = f"must be a file that is an EDS of a CiA 402 drive: {error}"
        raise ConfigurationError("link.can.eds", eds, allowed) from error
    lacking = [f"0x{index:04X}" for index in _NEEDED if index not in dictionary]
    if lacking:
        allowed = f"must describe a CiA 402 drive; it lacks {', '.join(lacking)}"
        raise ConfigurationError("link.can.eds", eds, allowed)


@cache
def _parsed(eds: str, _changed_ns: int, node_id: int) -> ObjectDictionary:
    return canopen.import_od(eds, node_id)
