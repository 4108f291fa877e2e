"""Refuses modules of a script that are named like a package of funnel-hil, as ``controller``.

Python has one module for each name: the script's would replace ours, or ours the script's.
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from pathlib import Path

_PACKAGES = ("bus_schema", "controller", "plant_emulator", "deploy")
_FOLDER = next(
    each for each in Path(__file__).resolve().parents if (each / "bus_schema/errors.py").is_file()
)


def require_ours() -> None:
    """Check that the names of our packages mean ours.

    Raises:
        ImportError: a module of the script has such a name.
    """
    for name in _PACKAGES:
        found = getattr(sys.modules.get(name), "__spec__", None) or PathFinder.find_spec(name)
        if found is None or found.origin is None:  # a mere folder, which replaces nothing
            continue
        file = Path(found.origin).resolve()
        if not file.is_relative_to(_FOLDER / name):
            what = file.parent if file.name == "__init__.py" else file
            raise ImportError(
                f"{what} has the name of a package of funnel-hil, which Python cannot import"
                f" beside it: rename it, for instance to my_{what.name}"
            )


require_ours()
