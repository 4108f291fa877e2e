"""The effective scenario: all values in force, for new runs and for agreement between processes."""

from __future__ import annotations

import hashlib
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any

import numpy as np

from bus_schema.limits import LimitsConfiguration
from bus_schema.link.agreement import Agreement
from bus_schema.recording.atomic_files import write_whole
from controller.configuration import ControllerConfiguration
from controller.laws import LAWS
from deploy.scenario.referenced_files import data_files
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import leaves, plain, set_value, to_yaml
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics.engines import engine_name

_DIGITS = 8
_OF_EACH_HOST = (
    "link.plant_endpoint", "link.controller_endpoint", "link.router_endpoint",
    "link.security.folder", "link.connect_timeout_s", "link.reply_timeout_s",
    "link.can.interface", "link.can.channel", "link.can.port", "plant.gui",
)  # fmt: skip
"""Keys that may differ: locations, and waiting times."""
_READING = ("xacro", "include", "mass_kg", "hold")
"""Keys of ``robot`` that have their effect when the arm's file is read."""


def effective_scenario(setup: Setup, files: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return `effective_values` as YAML.

    Args:
        setup: the scenario.
        files: paths to write instead of absolute ones, by dotted key.
    """
    values = effective_values(setup)
    if "robot.urdf" in files:  # a copy, which these values are already in
        values["robot"] = {k: v for k, v in values["robot"].items() if k not in _READING}
    for key, path in files.items():
        set_value(values, key, path)
    return to_yaml(values)


def effective_values(setup: Setup) -> dict[str, Any]:
    """Return the scenario in force: defaults, overrides and derived values; paths absolute.

    Default endpoints, CAN buses and start of judging are left out: a new run may choose others, or
    another duration.
    """
    given = setup.scenario
    values: dict[str, Any] = plain(
        given.model_copy(
            update={
                "controller": _with_gains(setup),
                "limits": _with_limits(setup),
                "plant": _plant_in_force(setup),
            }
        )
    )
    values["robot"]["urdf"] = str(setup.robot.path)
    for key in {"plant_endpoint", "controller_endpoint"} - given.link.model_fields_set:
        del values["link"][key]
    if "from_s" not in given.metrics.model_fields_set:
        del values["metrics"]["from_s"]
    for key in {"channel", "port"} - given.link.can.model_fields_set:
        values["link"]["can"].pop(key, None)
    return values


def write_scenario(setup: Setup, path: Path) -> None:
    """Write the scenario in force, with copies of its URDF and its other files beside it.

    The names of copies include a digest, so that scenarios in one folder share equal ones.

    Args:
        setup: the scenario.
        path: the YAML file; it refers to the copies by relative paths.

    Raises:
        OSError: a file cannot be written.
    """
    for name, content in _copies(setup).values():
        if not (path.parent / name).exists():
            write_whole(path.parent / name, content)
    write_whole(path, portable_scenario(setup))


def portable_scenario(setup: Setup) -> str:
    """The scenario in force as `write_scenario` writes it, and as recordings hold it."""
    return effective_scenario(setup, {key: name for key, (name, _) in _copies(setup).items()})


def _copies(setup: Setup) -> dict[str, tuple[str, bytes]]:
    """Name and content of a copy of each file that a scenario refers to, by its key."""
    robot = setup.robot
    arm = robot.path
    if arm.suffix in (".xacro", ".xml"):  # the copy replaces it
        arm = arm.with_name(f"{arm.stem.removesuffix('.urdf')}.urdf")
    found = {"robot.urdf": (arm, robot.portable_urdf().encode())}
    for key, file in data_files(setup.scenario).items():
        found[key] = (file, file.read_bytes())
    return {key: (_name(file, content), content) for key, (file, content) in found.items()}


def is_copy(file: Path) -> bool:
    """Whether a file is such a copy, by its name and contents."""
    digest = file.stem[-_DIGITS - 1 :]
    if not re.fullmatch(rf"-[0-9a-f]{{{_DIGITS}}}", digest) or not file.is_file():
        return False
    return hashlib.sha256(file.read_bytes()).hexdigest()[:_DIGITS] == digest[1:]


def _name(original: Path, content: bytes) -> str:
    digest = hashlib.sha256(content).hexdigest()[:_DIGITS]
    stem = original.stem.removesuffix(f"-{digest}")  # it may itself be such a copy
    return f"{stem}-{digest}{original.suffix}"


def _with_gains(setup: Setup) -> ControllerConfiguration:
    controller = setup.scenario.controller
    if controller.law not in LAWS:
        return controller
    gains = {**controller.gains, controller.law: setup.gains}
    ordered = {law: gains[law] for law in (*LAWS, *gains) if law in gains}
    return controller.model_copy(update={"gains": ordered})


def _with_limits(setup: Setup) -> LimitsConfiguration:
    limits = setup.scenario.limits
    in_force = limits.of_plant(setup.robot)
    known = {
        name: limit
        for name in ("torque_nm", "velocity_rad_s", "torque_rate_nm_s")
        if np.isfinite(limit := getattr(in_force, name)).all()  # without a key, the same as null
    }
    return limits.model_copy(update=known)


def _plant_in_force(setup: Setup) -> PlantConfiguration:
    plant, drive = setup.scenario.plant, setup.drive
    engine = plant.physics.model_copy(update={"engine": engine_name(plant)})
    plant = plant.model_copy(update={"physics": engine})
    if not drive.is_active:
        return plant
    loop = {"stiffness_nm_rad": drive.stiffness_nm_rad, "damping_nm_s": drive.damping_nm_s}
    return plant.model_copy(update={"drive_feedback": plant.drive_feedback.model_copy(update=loop)})


def agreement_of(setup: Setup, run_key: str = "") -> Agreement:
    """Return the values that the processes of a run agree on, for any engine of the plant."""
    values = values_in_common(setup)
    del values["plant.physics.engine"]  # the default depends on the engines installed there
    return Agreement(values, run_key)


def values_in_common(
    setup: Setup, recorded: Mapping[str, str] = MappingProxyType({})
) -> dict[str, str]:
    """Return every value in force except the host's, as JSON; files are compared by content.

    Args:
        setup: the scenario.
        recorded: texts of files that only a recording contains, by dotted key; others are read.
    """
    nested = effective_values(setup)
    values = {
        key: json.dumps(value, default=str)
        for key, value in leaves(nested)
        if not key.startswith(tuple(f"robot.{name}" for name in _READING))
    }
    for key in _OF_EACH_HOST:
        values.pop(key, None)
    values["robot.urdf"] = _arm(setup.robot.text)
    for key, file in data_files(setup.scenario).items():
        values[key] = recorded[key] if key in recorded else _text_of(file)
    return values


def _text_of(file: Path) -> str:
    """The content of a file, with any line ends; a digest where it is no text."""
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return hashlib.sha256(file.read_bytes()).hexdigest()


def _arm(urdf: str) -> str:
    """Return a URDF without parts that depend on host or editor: comments, white space, folders."""
    root = ET.fromstring(urdf)
    for mesh in root.iter("mesh"):
        mesh.set("filename", PurePath(mesh.get("filename", "")).name)
    return ET.canonicalize(ET.tostring(root, encoding="unicode"), strip_text=True)
