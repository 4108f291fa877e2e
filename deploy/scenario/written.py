"""Scenarios with the files they refer to, for folders of results: what is run again is the same."""

from __future__ import annotations

import hashlib
from pathlib import Path

from bus_schema.recording.atomic_files import write_whole
from deploy.scenario.referenced_files import delay_files
from deploy.scenario.scenario import effective_scenario
from deploy.scenario.setup import Setup

_DIGITS = 8


def write_scenario(setup: Setup, path: Path) -> None:
    """Write the scenario in force, and beside it copies of its URDF and its files of delays.

    Copies are named by their contents too, so that scenarios in one folder share equal ones.

    Args:
        setup: the scenario.
        path: the YAML file; it names the copies by relative paths.

    Raises:
        OSError: the disk does not take it.
    """
    robot = setup.robot
    files = {"robot.urdf": _copy(robot.portable_urdf(), robot.path, path.parent)}
    for direction, file in delay_files(setup.scenario.link).items():
        name = _copy(file.read_text(), file, path.parent)
        files[f"link.{direction}.distribution_file"] = name
    write_whole(path, effective_scenario(setup, files))


def _copy(text: str, original: Path, folder: Path) -> str:
    """The name of a file of this text in a folder, written unless it is there."""
    digest = hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]
    stem = original.stem.removesuffix(f"-{digest}")  # it may itself be such a copy
    name = f"{stem}-{digest}{original.suffix}"
    if not (folder / name).exists():
        write_whole(folder / name, text)
    return name
