"""Folders of ROS packages, found by the name in their ``package.xml``, without ROS."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path

INCLUDE = "FUNNEL_HIL_INCLUDE"
"""Environment variable: additional folders that files may be included from."""
ROS_PATHS = ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH")
"""Environment variables: folders where ROS looks for packages."""

_MOST_FOLDERS, _DEEPEST = 5000, 4
_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")


def folders_in(variable: str) -> list[Path]:
    """Return the folders that an environment variable names."""
    return [Path(each).resolve() for each in os.environ.get(variable, "").split(os.pathsep) if each]


def find_package(name: str, file: Path, named: Sequence[Path] = ()) -> Path | None:
    """Return the folder of a ROS package; None if there is none.

    It is at, above or beside the file, in the file's repository, below a folder that the user
    names, or where ROS looks for it.

    Args:
        name: its name.
        file: a file that refers to it.
        named: folders that the user names, besides those of `INCLUDE`.
    """
    if name in ("", ".", "..") or "/" in name:
        return None
    return _found(name, file.resolve(), (*named, *folders_in(INCLUDE)))


@lru_cache(maxsize=256)
def _found(name: str, file: Path, named: tuple[Path, ...]) -> Path | None:
    installed = [prefix / "share" / name for prefix in folders_in(ROS_PATHS[0])]
    likely = [folder for parent in file.parents for folder in (parent, parent / name)]
    for folder in (*named, *(parent / name for parent in named), *likely, *installed):
        is_named = folder in named and folder.name == name and folder.is_dir()
        if is_named or _name_of(folder) == name or (folder.name == name and _name_of(folder)):
            return folder
    roots = (*named, *repository_of(file), *folders_in(ROS_PATHS[1]))
    for folder in (inside for root in roots for inside in _below(root)):
        if _name_of(folder) == name:
            return folder
    return None


@lru_cache(maxsize=_MOST_FOLDERS)
def _name_of(folder: Path) -> str:
    """Return the name of the package in a folder; an empty text if there is none."""
    try:
        with (folder / "package.xml").open(encoding="utf-8", errors="replace") as stream:
            found = _NAME.search(stream.read(10_000))
    except OSError:
        return ""
    return found[1] if found else folder.name


def repository_of(file: Path) -> list[Path]:
    """Return the root of a file's repository, or else the folder around its package."""
    for folder in file.parents:
        if (folder / ".git").exists():
            return [folder]
    packages = [folder for folder in file.parents if _name_of(folder)]
    return [packages[-1].parent] if packages else []


def _below(root: Path) -> Iterator[Path]:
    """Return a folder and those below it, as far as a search goes."""

    def walked() -> Iterator[Path]:
        for place, inside, _ in os.walk(root):
            folder = Path(place)
            is_deep = len(folder.parts) - len(root.parts) >= _DEEPEST
            inside[:] = [] if is_deep else sorted(each for each in inside if each[0] != ".")
            yield folder

    return islice(walked(), _MOST_FOLDERS)
