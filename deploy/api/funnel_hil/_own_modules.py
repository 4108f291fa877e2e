"""Finds what hides the packages that funnel-hil is made of, before any of them is imported.

Python looks into the folder of a script, or the current one of a notebook, before it looks where
packages are installed: a file ``controller.py`` there takes the place of a package of ours.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

_PACKAGES = {
    "bus_schema": "registry.py",
    "controller": "control_law.py",
    "plant_emulator": "plant_loop.py",
    "deploy": "exit_codes.py",
}
"""Each with a file by which it is known."""


def require_own() -> None:
    """Check that all packages of ours are what an import finds.

    Raises:
        ImportError: something else is in the place of one, or none is there.
    """
    for name, known_by in _PACKAGES.items():
        file = _file_of(name)
        if file is None:
            raise ImportError(f"funnel_hil needs its package {name}, which is not installed")
        if not (file.parent / known_by).is_file():
            raise ImportError(
                f"{file} hides the package {name} that funnel_hil is made of: rename it, or move it"
                f" to another folder (the same goes for {', '.join(_PACKAGES)})"
            )


def _file_of(name: str) -> Path | None:
    """The file that ``import name`` runs, or has run."""
    if name in sys.modules:
        file = getattr(sys.modules[name], "__file__", None)
    else:
        spec = importlib.util.find_spec(name)
        file = None if spec is None else spec.origin
    return None if file is None else Path(file)


require_own()
