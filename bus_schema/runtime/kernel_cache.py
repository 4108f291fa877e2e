"""Choice of the folder for the machine code of kernels: the user's cache, or a substitute.

The folder is named by a hash of all sources that have kernels, see `compiled`.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import logging
import os
import shutil
import tempfile
from pathlib import Path

logger = logging.getLogger(__name__)
FOLDER = "NUMBA_CACHE_DIR"
"""Environment variable: the folder; unset where kernels cannot be kept."""
REFUSED = "FUNNEL_HIL_KERNELS_ARE_KEPT_ELSEWHERE"
"""Environment variable: why the usual folder is not used; children do not report it again."""
_SOURCES = Path(__file__).resolve().parents[2]
PACKAGES = ("controller", "plant_emulator", "bus_schema")
"""The packages with kernels."""
_ENOUGH_BYTES = 32 << 20
"""Larger than all kernels."""


def choose_folder() -> bool:
    """Choose the folder of kernels for this process and its children; whether one is usable."""
    if REFUSED in os.environ:
        return FOLDER in os.environ
    name = Path("numba", _digest_of_sources())
    try:
        given = os.environ.get(FOLDER)
        usual = _usable(Path(given)) if given else _usable(_user_cache(), name)
    except OSError as error:
        _choose_temporary_folder(name, error)
    else:
        os.environ[FOLDER] = str(usual)
    return FOLDER in os.environ


def report_refusal(reason: str) -> None:
    """Warn that kernels are not kept in the usual folder, once for a process and its children."""
    if REFUSED not in os.environ:
        os.environ[REFUSED] = reason
        logger.warning("%s", reason)


def _choose_temporary_folder(name: Path, reason: OSError) -> None:
    os.environ.pop(FOLDER, None)
    try:
        own = Path(tempfile.gettempdir(), f"funnel-hil-{os.getuid()}")
        if own.is_symlink():
            raise PermissionError(errno.EPERM, "is a link", str(own))
        os.environ[FOLDER] = str(_usable(own, name))
    except OSError as error:
        instead = f"every process compiles them again ({error})"
    else:
        instead = f"they are stored in {own} ({FOLDER} or XDG_CACHE_HOME can name another folder)"
    report_refusal(f"compiled kernels cannot be stored in the usual folder ({reason}): {instead}")


def _usable(top: Path, name: Path = Path()) -> Path:
    """Create a folder; raise OSError if no kernel can be written to it, or others could do so."""
    folder = top / name
    for each in (*reversed(folder.parents), folder):
        each.mkdir(mode=0o700, exist_ok=True)  # under any umask
    _require_own(top, folder)
    with tempfile.TemporaryFile(dir=folder):
        pass
    if shutil.disk_usage(folder).free < _ENOUGH_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
    return folder


def _require_own(top: Path, folder: Path) -> None:
    """Require that no other user wrote to these folders, as their machine code is run.

    Files in a folder that only this user can enter may have any mode, as numba obeys the umask.

    Raises:
        PermissionError: another user owns a folder or file, or may write to it.
    """
    above = [each for each in (folder, *folder.parents) if each.is_relative_to(top)]
    is_closed = not all(each.stat().st_mode & 0o077 for each in above)
    for path in (*above, *folder.rglob("*")):
        with contextlib.suppress(FileNotFoundError):  # numba renames its files
            found = path.stat()
            is_open = bool(found.st_mode & 0o022) and not (is_closed and path not in above)
            if is_open or found.st_uid not in (0, os.getuid()):
                what = "belongs to another user, or others can write to it; remove it"
                raise PermissionError(errno.EPERM, what, str(path))


def _user_cache() -> Path:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111
    if not cache.is_absolute():
        raise FileNotFoundError(errno.ENOENT, "the user has no home folder, HOME is not set")
    return cache / "funnel-hil"


def place_of(source: str) -> str:
    """Return the folder for the kernels of one of our files, by its package; empty for others."""
    path = Path(source).resolve()
    inside = path.relative_to(_SOURCES).parts[:-1] if path.is_relative_to(_SOURCES) else ()
    return ".".join(inside) if inside[:1] and inside[0] in PACKAGES else ""


def _digest_of_sources() -> str:
    digest = hashlib.sha256()
    for package in PACKAGES:
        for source in sorted((_SOURCES / package).rglob("*.py")):
            text = source.read_bytes()
            if b"\n@compiled" in text:
                digest.update(text)
    return digest.hexdigest()[:16]
