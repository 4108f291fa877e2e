"""Finds what hides the packages that funnel-hil is made of, before any of them is imported.

Python looks into the folder of a script, or the current one of a notebook, before it looks where
packages are installed: a file ``controller.py`` there takes the place of a package of ours.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

_PACKAGES = {
    "bus_schema": "registry.py",
    "controller": "control_law.py",
    "plant_emulator": "plant_loop.py",
    "deploy": "run/execute.py",
}
"""Each with a file by which it is known."""


def require_own() -> None:
    """Check that all packages of ours are what an import finds.

    Raises:
        ImportError: something else is in the place of one, or none is there.
    """
    for name, known_by in _PACKAGES.items():
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise ImportError(f"funnel_hil needs its package {name}, which is not installed")
        file = Path(spec.origin)
        if not (file.parent / known_by).is_file():
            raise ImportError(
                f"{file} hides the package {name} that funnel_hil is made of: rename it, or move it"
                f" to another folder (the same goes for {', '.join(_PACKAGES)})"
            )


require_own()
