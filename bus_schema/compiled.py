"""Compilation of the numerical kernels with numba.

numba's own cache looks only at the file a function stands in, not at the functions it calls in
other files. So that an edited helper can never leave a stale caller behind, each package's kernels
are cached under a folder named by a hash of the package's sources.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")


def _cache_folder() -> Path:
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256()
    sources = Path(__file__).resolve().parent.parent
    for package in ("controller", "plant_emulator", "bus_schema"):
        for source in sorted((sources / package).rglob("*.py")):
            digest.update(source.read_bytes())
    return root / "funnel-hil" / "numba" / digest.hexdigest()[:16]


os.environ.setdefault("NUMBA_CACHE_DIR", str(_cache_folder()))

import numba  # noqa: E402  (reads its cache folder at import)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` at its first call, with IEEE semantics, and cache the machine code."""
    return cast("Callable[P, R]", numba.njit(cache=True, error_model="numpy")(function))
