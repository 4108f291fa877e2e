"""Digests of the user's files that Python reads.

An audit hook sees every file that Python opens, in this thread and those started meanwhile:
modules, tables, weights and libraries of ``ctypes``. It sees neither files that a library opens in
C, nor checks whether a file exists.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import sysconfig
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.util import source_from_cache
from pathlib import Path
from typing import Any

OURS = ("bus_schema", "controller", "deploy", "plant_emulator", "funnel_hil")
"""Names of our packages, which no user module replaces."""
OUR_FOLDER = str(Path(__file__).resolve().parents[2])

_INSTALLED = ("/site-packages/", "/dist-packages/")
_EXAMPLES = f"{OUR_FOLDER}/deploy/docs/"
_PYTHON = [Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")]
_OF_OTHERS = (
    *(f"{OUR_FOLDER}/{name}/" for name in OURS),
    *(f"{path}/" for each in _PYTHON for path in (each, each.resolve())),
    "/proc/", "/sys/", "/dev/",
)  # fmt: skip
_SHARED_MEMORY = "/dev/shm/"
_CACHES = (".nbi", ".nbc", f"/python{sysconfig.get_config_var('py_version_nodot')}.zip")
"""Compiled functions of numba, which belong to their module; an archive of Python's own modules."""
_DIGITS = 16
_WRITTEN = ""
ABSENT = "absent"
"""In place of a digest: there was no such file."""


@dataclass(frozen=True)
class _Reading:
    """Digests of files by path, and threads from before, whose files do not count."""

    read: dict[str, str]
    other_threads: set[threading.Thread]


_reading: list[_Reading] = []


def is_of_the_user(path: str) -> bool:
    """Whether a file is neither installed, nor Python's, nor ours, nor a cache, nor generated."""
    is_of_others = path.startswith(_OF_OTHERS) and not path.startswith((_EXAMPLES, _SHARED_MEMORY))
    return not (is_of_others or path.endswith(_CACHES) or any(part in path for part in _INSTALLED))


def digest_of_file(path: Path) -> str | None:
    """Return a digest of a regular file; None if there is none that can be read."""
    try:
        if not path.is_file():  # opening a pipe could wait for ever
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()[:_DIGITS]
    except (OSError, ValueError):
        return None


@contextlib.contextmanager
def files_read() -> Iterator[dict[str, str]]:
    """Yield the digests, by path, of the user's files that are read while the context lasts.

    A file that is also written is a result, not an input, and has an empty digest. At the end,
    files that no longer exist are left out. A file that was missing when it was opened is `ABSENT`.
    """
    _install_hook()
    read: dict[str, str] = {}
    reading = _Reading(read, {*threading.enumerate()} - {threading.current_thread()})
    _reading.append(reading)
    try:
        yield read
    finally:
        _reading[:] = [each for each in _reading if each is not reading]
        for path in [path for path in read if read[path] != ABSENT and not Path(path).exists()]:
            del read[path]


@cache
def _install_hook() -> None:
    """Install the hook, which cannot be removed."""
    sys.addaudithook(_hook)


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if _reading and event in ("open", "ctypes.dlopen"):
        with contextlib.suppress(Exception):  # it would end the call that opens the file
            _note(arguments[0], arguments[2] if event == "open" else os.O_RDONLY)


def _note(name: Any, flags: int) -> None:
    if not isinstance(name, str | bytes | os.PathLike):
        return
    path = str(Path(os.fsdecode(name)).absolute())  # of a link, which may lead elsewhere later
    if not (is_of_the_user(path) or is_of_the_user(os.path.realpath(path))):
        return
    if path.endswith(".pyc"):
        path = source_from_cache(path)
    thread = threading.current_thread()
    reading = [each.read for each in _reading if thread not in each.other_threads]
    if flags & (os.O_WRONLY | os.O_RDWR):
        for read in reading:
            read[path] = _WRITTEN
    elif unknown := [read for read in reading if path not in read]:
        for read in unknown:
            read[path] = _WRITTEN  # until it is read, which comes here once more
        digest = digest_of_file(Path(path)) or ("" if os.path.lexists(path) else ABSENT)
        for read in unknown:
            read[path] = digest
