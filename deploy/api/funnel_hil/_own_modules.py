"""Lets a script and funnel-hil each import their own module of one name, such as ``controller``.

Python has one module for each name. Where a file beside the script, or in the current folder, has
the name of a package of funnel-hil, this gives the file another name inside Python. Which of the
two an import statement gets depends on the file that it stands in.
"""

from __future__ import annotations

import builtins
import os
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

_PACKAGES = ("bus_schema", "controller", "plant_emulator", "deploy")
_HERE = Path(__file__).resolve().parent
_FOLDER = next(each for each in _HERE.parents if (each / "bus_schema" / "errors.py").is_file())
_FOLDERS = (_HERE, *(_FOLDER / name for name in _PACKAGES), sysconfig.get_path("stdlib"))
_NOT_OF_SCRIPT = tuple(f"{folder}{os.sep}" for folder in _FOLDERS)
_INSTALLED = f"-packages{os.sep}"  # site-packages; dist-packages on Debian
_import = builtins.__import__


class _OfTheScript:
    """Finds packages of funnel-hil by their names, and files of the script by other names."""

    def __init__(self) -> None:
        elsewhere = [place for place in sys.path if Path(place).resolve() != _FOLDER]
        found = {name: PathFinder.find_spec(name, elsewhere) for name in _PACKAGES}
        self._files = {_renamed(name): it for name, it in found.items() if it and it.has_location}

    def install(self) -> None:
        """Take part in every import from now on, if any name is used twice."""
        if not self._files:
            return
        for name, module in list(sys.modules.items()):  # the script may have imported its own
            if self._is_shared(name) and _is_of_script(vars(module)):
                self._rename(module, name)
        sys.meta_path.insert(0, self)
        builtins.__import__ = self._imported

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if (spec := self._files.get(name)) is not None:
            inside = spec.submodule_search_locations
            return spec_from_file_location(name, spec.origin, submodule_search_locations=inside)
        is_ours = path is None and self._is_shared(name)
        return PathFinder.find_spec(name, [str(_FOLDER)], target) if is_ours else None

    def _rename(self, module: ModuleType, name: str) -> None:
        """Rename an imported module, or one that imports funnel_hil while it is imported."""
        new = module.__name__ = _renamed(name)
        if module.__spec__ is not None:
            module.__spec__.name = new
            module.__package__ = module.__spec__.parent
        for value in vars(module).values():
            if isinstance(value, type) and value.__module__ == name:
                value.__module__ = new  # by which it is pickled
        sys.modules[new] = sys.modules.pop(name)

    def _is_shared(self, name: str) -> bool:
        return _renamed(name.partition(".")[0]) in self._files

    def _imported(self, name: str, *given: Any, **named: Any) -> ModuleType:
        """What Python's own function of these arguments imports for the module that asks."""
        more = dict(zip(("globals", "locals", "fromlist", "level"), given, strict=False)) | named
        is_absolute = not more.get("level")
        if is_absolute and self._is_shared(name) and _is_of_script(more.get("globals") or {}):
            name = _renamed(name)
        return _import(name, **more)


def _renamed(name: str) -> str:
    """What the script's module of this name is called inside Python."""
    return f"script_{name}"


def _is_of_script(names: Mapping[str, object]) -> bool:
    """Whether a module with these global names is the user's own."""
    file = str(names.get("__file__"))
    return not file.startswith(_NOT_OF_SCRIPT) and _INSTALLED not in file


_OfTheScript().install()
