"""Messages of our own types as older versions had them, brought to today's form."""

from __future__ import annotations

import contextlib
import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from bus_schema.messages.cdr_types import fields_of, zero_message
from bus_schema.messages.types import PACKAGE, TYPESTORE

Translate = Callable[[bytes], bytes]


def translation(type_name: str, recorded: str) -> Translate | None:
    """What brings recorded payloads to today's form; None where they need none or allow none.

    Numbers that there were not yet are NaN, or 0 where they are whole; arrays and texts are empty.
    What is no more is left out. A payload that is none of its type stays as it is.

    Args:
        type_name: ROS 2 interface name.
        recorded: its schema in the recording.
    """
    if not type_name.startswith(PACKAGE) or type_name not in TYPESTORE.fielddefs:
        return None
    store = get_typestore(Stores.EMPTY)
    with contextlib.suppress(Exception):  # what rosbags trips over in a text that is no schema
        store.register(get_types_from_msg(recorded, type_name))
        if store.hash_rihs01(type_name) != TYPESTORE.hash_rihs01(type_name):
            return lambda payload: _translated(payload, type_name, store)
    return None


def _translated(payload: bytes, type_name: str, store: Typestore) -> bytes:
    with contextlib.suppress(Exception):  # what rosbags trips over in a payload of another type
        message = _in_todays_form(store.deserialize_cdr(payload, type_name), type_name)
        return bytes(TYPESTORE.serialize_cdr(message, type_name))
    return payload


def _in_todays_form(older: Any, type_name: str) -> Any:
    """A message of today's type with what is in one of the older type; None for none at all."""
    message = zero_message(type_name, defaultdict(int), {})
    for field, kind, argument in fields_of(type_name):
        value = getattr(older, field, None)
        if kind == Nodetype.NAME:
            value = _in_todays_form(value, argument)
        elif value is None and kind == Nodetype.BASE and argument[0].startswith("float"):
            value = math.nan
        if value is not None:
            setattr(message, field, value)
    return message
