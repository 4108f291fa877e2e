"""Choice of the folder for the machine code of kernels: the user's cache, or a substitute.

The folder is named by a hash of all sources that have kernels, see `compiled`.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import shutil
import stat
import tempfile
from pathlib import Path

logger = logging.getLogger(__name__)
FOLDER = "NUMBA_CACHE_DIR"
"""Environment variable: the folder; unset where kernels cannot be kept."""
REFUSED = "FUNNEL_HIL_KERNELS_ARE_KEPT_ELSEWHERE"
"""Environment variable: why the usual folder is not used; child processes do not report it again.
say again."""
_ENOUGH_BYTES = 32 << 20
"""Larger than all kernels."""


def choose_folder() -> bool:
    """Choose the folder of kernels for this process and its children; whether one is usable."""
    if REFUSED in os.environ:
        return FOLDER in os.environ
    name = Path("numba", _digest_of_sources())
    try:
        usual = Path(os.environ.get(FOLDER) or _user_cache() / name)
        _make_usable(usual)
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
        own.mkdir(mode=0o700, exist_ok=True)
        found = own.lstat()
        # Its machine code is run: no other user may own it or write into it.
        if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o022 or own.is_symlink():
            raise PermissionError(errno.EPERM, "belongs to another user", str(own))
        _make_usable(own / name)
        os.environ[FOLDER] = str(own / name)
    except OSError as error:
        instead = f"every process compiles them again ({error})"
    else:
        instead = f"they are stored in {own} ({FOLDER} or XDG_CACHE_HOME can name another folder)"
    report_refusal(f"compiled kernels cannot be stored in the usual folder ({reason}): {instead}")


def _make_usable(folder: Path) -> None:
    """Create a folder; raise OSError if no kernel can be written to it."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        pass
    if shutil.disk_usage(folder).free < _ENOUGH_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


def _user_cache() -> Path:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111
    if not cache.is_absolute():
        raise FileNotFoundError(errno.ENOENT, "the user has no home folder, HOME is not set")
    return cache / "funnel-hil"


def _digest_of_sources() -> str:
    digest = hashlib.sha256()
    sources = Path(__file__).resolve().parents[2]
    for package in ("controller", "plant_emulator", "bus_schema"):
        for source in sorted((sources / package).rglob("*.py")):
            text = source.read_bytes()
            if b"\n@compiled" in text:
                digest.update(text)
    return digest.hexdigest()[:16]
