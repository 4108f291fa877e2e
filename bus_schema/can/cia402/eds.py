"""Descriptions of CANopen devices, parsed once for each file and node."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import canopen
from canopen.objectdictionary import ObjectDictionary


def object_dictionary(eds: Path | str, node_id: int) -> ObjectDictionary:
    """The objects of a node; they hold no values, so all nodes of an address can share them.

    Raises:
        Exception: whatever canopen's parser makes of a file that is no EDS.
    """
    return _parsed(str(eds), Path(eds).stat().st_mtime_ns, node_id)


@cache
def _parsed(eds: str, _changed_ns: int, node_id: int) -> ObjectDictionary:
    return canopen.import_od(eds, node_id)
