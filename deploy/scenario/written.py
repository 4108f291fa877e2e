"""Scenarios with the files they refer to, for folders of results: what is run again is the same."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from bus_schema.recording.atomic_files import write_whole
from deploy.scenario.referenced_files import data_files
from deploy.scenario.scenario import effective_scenario
from deploy.scenario.setup import Setup

_DIGITS = 8


def write_scenario(setup: Setup, path: Path) -> None:
    """Write the scenario in force, and beside it copies of its URDF and its other files.

    Copies are named by their contents too, so that scenarios in one folder share equal ones.

    Args:
        setup: the scenario.
        path: the YAML file; it names the copies by relative paths.

    Raises:
        OSError: the disk does not take it.
    """
    texts = _texts(setup)
    for name, text in texts.values():
        if not (path.parent / name).exists():
            write_whole(path.parent / name, text)
    write_whole(path, portable_scenario(setup))


def portable_scenario(setup: Setup) -> str:
    """The scenario in force as `write_scenario` writes it, and as recordings hold it."""
    return effective_scenario(setup, {key: name for key, (name, _) in _texts(setup).items()})


def _texts(setup: Setup) -> dict[str, tuple[str, str]]:
    """Name and text of a copy of each file that a scenario refers to, by its key."""
    robot = setup.robot
    arm = robot.path
    if arm.suffix in (".xacro", ".xml"):  # the copy is what it stands for
        arm = arm.with_name(f"{arm.stem.removesuffix('.urdf')}.urdf")
    found = {"robot.urdf": (arm, robot.portable_urdf())}
    for key, file in data_files(setup.scenario).items():
        found[key] = (file, file.read_text())
    return {key: (_name(file, text), text) for key, (file, text) in found.items()}


def is_copy(file: Path) -> bool:
    """Whether a file is such a copy, as its name and contents say."""
    digest = file.stem[-_DIGITS - 1 :]
    if not re.fullmatch(rf"-[0-9a-f]{{{_DIGITS}}}", digest) or not file.is_file():
        return False
    return hashlib.sha256(file.read_bytes()).hexdigest()[:_DIGITS] == digest[1:]


def _name(original: Path, text: str) -> str:
    digest = hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]
    stem = original.stem.removesuffix(f"-{digest}")  # it may itself be such a copy
    return f"{stem}-{digest}{original.suffix}"
