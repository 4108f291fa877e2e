"""The C functions in pybullet's library, by name.

Names and arguments are those of ``examples/SharedMemory/PhysicsClientC_API.h`` and
``SharedMemoryPublic.h`` in Bullet's sources.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

_ONE_AT_A_TIME = threading.RLock()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Discard all output to standard output and error while the context lasts.

    This affects other threads too: use it in the main thread where possible.
    """
    flush = ctypes.CDLL(None).fflush
    with _ONE_AT_A_TIME:  # otherwise one thread could restore another's /dev/null
        sys.stdout.flush()
        kept = [os.dup(1), os.dup(2)]
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            flush(None)
            os.dup2(nowhere, 1)
            os.dup2(nowhere, 2)
            yield
        finally:
            flush(None)
            for descriptor, copy in enumerate(kept, start=1):
                os.dup2(copy, descriptor)
                os.close(copy)
            os.close(nowhere)


INT, DOUBLE = ctypes.c_int, ctypes.c_double
_NAME_BYTES = 1024


class JointInfo(ctypes.Structure):
    """The beginning of ``b3JointInfo``, and space for the rest."""

    _fields_ = (
        ("link_name", ctypes.c_char * _NAME_BYTES),
        ("joint_name", ctypes.c_char * _NAME_BYTES),
        ("joint_type", ctypes.c_int),
        ("position_index", ctypes.c_int),
        ("velocity_index", ctypes.c_int),
        ("index_and_flags", ctypes.c_int * 2),
        ("limits", ctypes.c_double * 6),
        ("parent_frame", ctypes.c_double * 7),
        ("child_frame", ctypes.c_double * 7),
        ("rest", ctypes.c_char * 2048),
    )


def _load_library() -> ctypes.CDLL:
    found = importlib.util.find_spec("pybullet")
    if found is None or found.origin is None:
        raise ImportError("pybullet is not installed")
    return ctypes.CDLL(found.origin)


LIBRARY = _load_library()


class Handle(ctypes.c_void_p):
    """A server, a command or a status: what Bullet's functions pass on without looking inside."""


def call(name: str, *arguments: Any) -> int:
    """Call the function ``b3<name>``, which returns a number."""
    number: int = _call(name, INT, arguments)
    return number


def handle(name: str, *arguments: Any) -> Handle:
    """Call the function ``b3<name>``, which returns a handle."""
    result: Handle = _call(name, Handle, arguments)
    return result


def _call(name: str, result: Any, arguments: tuple[Any, ...]) -> Any:
    function = getattr(LIBRARY, "b3" + name)
    function.restype = result
    return function(*(DOUBLE(each) if isinstance(each, float) else each for each in arguments))
