"""Where modules of a user's own are found: in the current folder, behind what is installed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from itertools import zip_longest
from pathlib import Path
from types import ModuleType

OURS = ("bus_schema", "controller", "deploy", "plant_emulator", "funnel_hil")
"""Names of packages of ours, which nothing of a user's takes the place of."""

_OUR_FOLDER = str(Path(__file__).resolve().parents[2])


class _OtherFilesOfOurFolderLast:
    """Finds whatever is no package of ours in a user's folder before it is looked for in our own.

    Our folder may be a clone, with any files in it. It stands before the user's on Python's path
    for the sake of our packages alone.
    """

    def __init__(self) -> None:
        self.folders: set[str] = set()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Where a module is; None for Python's own ways."""
        if path is not None or name in OURS:
            return None
        each_with_next = zip_longest(sys.path, sys.path[1:], fillvalue="")
        places = [
            place for place, then in each_with_next
            if not (place == _OUR_FOLDER and then in self.folders)
        ]  # fmt: skip
        spec = PathFinder.find_spec(name, places, target)
        return spec if spec is not None and spec.loader is not None else None  # no mere folder


_finder = _OtherFilesOfOurFolderLast()


def find_in_current_folder() -> None:
    """Let imports find the modules in the current folder, as with ``python -m``."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path += [_OUR_FOLDER, here]  # in this order: other processes get it, and import ours
    _finder.folders.add(here)
    if _finder not in sys.meta_path:
        sys.meta_path.insert(sys.meta_path.index(PathFinder), _finder)
