"""URDFs written with xacro's macros, expanded without ROS."""

from __future__ import annotations

from pathlib import Path
from xml.parsers.expat import ExpatError

import xacro
from xacro import substitution_args

from bus_schema.errors import RobotDescriptionError


def is_xacro(path: Path) -> bool:
    """Whether a file is named as one with macros is."""
    return path.suffix == ".xacro"


def expanded(path: Path) -> str:
    """The URDF that a xacro file stands for, with its arguments' own defaults.

    Packages in ``$(find …)`` are folders of that name at or above the file.

    Raises:
        RobotDescriptionError: xacro refuses it; the file is named.
    """

    def package(name: str) -> str:
        for folder in path.resolve().parents:
            for candidate in (folder, folder / name):
                if candidate.name == name and candidate.is_dir():
                    return str(candidate)
        raise RobotDescriptionError(f"{path}: no folder {name!r} at or above it for $(find {name})")

    substitution_args._eval_find = package  # else it asks a ROS installation
    try:
        return str(xacro.process_file(str(path)).toxml())
    except (xacro.XacroException, ExpatError, OSError, UnicodeDecodeError) as error:
        raise RobotDescriptionError(f"{path}: xacro: {error}") from error
