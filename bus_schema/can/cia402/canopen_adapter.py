"""Adapter to canopen for both sides: descriptions of devices, and a network on a bus of ours."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ObjectDictionary, ODVariable

from bus_schema.can.frame import CanFrame
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CIA402_EDS
from bus_schema.user_files import read_bytes

_USED = (
    (0x1000, 0), (0x1016, 1), (0x1017, 0), (0x1400, 5), (0x6040, 0), (0x6041, 0), (0x6060, 0),
    (0x6061, 0), (0x6064, 0), (0x606C, 0), (0x6071, 0), (0x6076, 0), (0x608F, 1), (0x6502, 0),
)  # fmt: skip
"""Objects that a master uses in torque mode; their types have to be those of our description."""

_USED_WITH_TARGETS = (
    (0x1402, 5), (0x1403, 1), (0x1602, 0), (0x1603, 0), (0x607A, 0), (0x60B1, 0), (0x60B2, 0),
    (0x60F9, 1), (0x60F9, 2), (0x60FB, 1),
)  # fmt: skip
_MAPPED = ((0x1A00, 0), (0x1A00, 1), (0x1A00, 2), (0x1A01, 1))
_MAPPED_TORQUE = ((0x1600, 0), (0x1600, 1), (0x1600, 2))
"""Mappings that a master relies on and does not write; they have to be those of ours."""


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
        Exception: any error of canopen's parser, for a file that is no EDS.
    """
    return _parsed(str(eds), Path(eds).stat().st_mtime_ns, node_id)


def check_eds(eds: str, *, takes_targets: bool) -> None:
    """Check the description of a drive that a scenario names.

    Args:
        eds: the file.
        takes_targets: whether the master uses position mode.

    Raises:
        ConfigurationError: it is no EDS, or does not describe what the master uses.
    """
    try:
        read_bytes(Path(eds))
        theirs = canopen.import_od(eds, 1)
        for each in theirs.values():
            for variable in (each,) if isinstance(each, ODVariable) else each.values():
                if (variable.data_type or 1) < 1:
                    raise ValueError(f"{variable.name} has data type {variable.data_type}")
    except Exception as error:  # the parser raises any type
        allowed = f"must be a file that is an EDS of a CiA 402 drive: {error}"
        raise ConfigurationError("link.can.eds", eds, allowed) from error
    ours = object_dictionary(CIA402_EDS, 1)
    used = _USED + (_USED_WITH_TARGETS if takes_targets else _MAPPED_TORQUE) + _MAPPED
    if wrong := [text for place in used if (text := _difference(theirs, ours, *place))]:
        allowed = f"must describe a CiA 402 drive; {'; '.join(wrong)}"
        raise ConfigurationError("link.can.eds", eds, allowed)


def _difference(
    theirs: ObjectDictionary, ours: ObjectDictionary, index: int, subindex: int
) -> str | None:
    """Return the error in an object; None for none."""
    found, wanted = theirs.get_variable(index, subindex), ours.get_variable(index, subindex)
    name = f"0x{index:04X}" + f":{subindex:02X}" * bool(subindex)
    if found is None or wanted is None:
        return f"it lacks {name}"
    if found.data_type != wanted.data_type:
        return f"{name} has data type 0x{found.data_type or 0:04X}, not 0x{wanted.data_type:04X}"
    # A DCF has the value that is written into a drive beside the drive's own default.
    value = found.default if found.value is None else found.value
    if (index, subindex) in _MAPPED + _MAPPED_TORQUE and value != wanted.default:
        return f"{name} maps {_mapped(value, subindex)}, not {_mapped(wanted.default, subindex)}"
    return None


def _mapped(value: int | None, subindex: int) -> str:
    """Name a value of a mapping: the number of objects, or one object with its length in bits."""
    if subindex == 0:
        return f"{value or 0} object" + "s" * (value != 1)
    return f"0x{value:08X}" if value else "nothing"


@cache
def _parsed(eds: str, _changed_ns: int, node_id: int) -> ObjectDictionary:
    return canopen.import_od(eds, node_id)
