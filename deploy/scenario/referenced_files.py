"""Files that a scenario refers to: the arm's URDF, and files of delays and of the reference."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import RobotDescriptionError, did_you_mean
from bus_schema.link.channel_configuration import TraceConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.resolved import pybullet_data
from bus_schema.urdf.xacro_files import is_xacro
from bus_schema.user_files import is_file, named_in_folder
from controller.configuration import ControllerConfiguration
from controller.reference_configuration import CsvConfiguration, ReferenceConfiguration
from controller.reference_file import KEY as REFERENCE_KEY
from deploy.scenario.checking.explanation import Origin
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.xacro_arguments import split_arguments
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.jitter import read_delays_ms
from plant_emulator.channel.trace_file import read_trace

DIRECTIONS = ("uplink", "downlink")
MODEL_KEY = "controller.model"
DATA_FILES = {
    "link.uplink.distribution_file": "uplink_delays.txt",
    "link.uplink.trace.file": "uplink_trace",
    "link.downlink.distribution_file": "downlink_delays.txt",
    "link.downlink.trace.file": "downlink_trace",
    REFERENCE_KEY: "reference.csv",
    MODEL_KEY: "nominal.urdf",
}
"""Names, in a recording, of the files that a scenario refers to, by dotted key."""
ROBOTS = Path(str(resources.files("deploy").joinpath("robots")))
TRACES = Path(str(resources.files("deploy").joinpath("traces")))
_PYBULLET_DATA = "pybullet_data:"


def folders_of(key: str, origin: Origin) -> tuple[Path, Path]:
    """Return the folders where a relative path of a scenario may start, the likelier first.

    That of the scenario's file, or the current one for what was set beside the file.
    """
    folders = (origin.file.parent, Path.cwd())
    return folders[::-1] if origin.is_set(key) else folders


def find_urdf(name: str, *bases: Path) -> Path:
    """The URDF file that a scenario names.

    Args:
        name: a path relative to one of `bases`, the name of a shipped robot, or ``pybullet_data:``
            with a path inside that package.
        bases: folders, the likelier ones first.

    Raises:
        RobotDescriptionError: there is no such file.
    """
    if name.startswith(_PYBULLET_DATA):
        candidates = [folder / name.removeprefix(_PYBULLET_DATA) for folder in pybullet_data()]
        if not candidates:
            raise RobotDescriptionError(
                "the package pybullet_data is not installed; pip install 'funnel-hil[bullet]'"
            )
    else:
        candidates = [*(base / name for base in bases), ROBOTS / f"{name}.urdf"]
    for candidate in candidates:
        if is_file(candidate):
            return candidate.resolve()
    for candidate in candidates:
        if held := named_in_folder(candidate):
            raise RobotDescriptionError(held)
    shipped = sorted(path.stem for path in ROBOTS.glob("*.urdf"))
    raise RobotDescriptionError(
        f"no such file; allowed are a path from {bases[0]}, a shipped robot ({', '.join(shipped)}),"
        f" or {_PYBULLET_DATA}<path in the package pybullet_data>{did_you_mean(name, shipped)}"
    )


def find_delay_files(scenario: ScenarioConfiguration, origin: Origin) -> LinkConfiguration:
    """The link with absolute paths to its files of delays, which are known to be usable.

    Args:
        scenario: whose link it is.
        origin: of the scenario's values.

    Raises:
        ConfigurationError: a file does not exist or is invalid.
    """
    link = scenario.link
    for direction in DIRECTIONS:
        channel, section = getattr(link, direction), f"link.{direction}"
        if channel.distribution_file is not None:
            key = f"{section}.distribution_file"
            path = _find(channel.distribution_file, key, origin)
            with _refusing(key, channel.distribution_file):
                read_delays_ms(path)
            channel = channel.model_copy(update={"distribution_file": str(path)})
        if channel.trace is not None:
            path = _find_trace(channel.trace, f"{section}.trace", origin, scenario)
            found = channel.trace.model_copy(update={"file": str(path)})
            channel = channel.model_copy(update={"trace": found})
        link = link.model_copy(update={direction: channel})
    return link


def _find_trace(
    given: TraceConfiguration, key: str, origin: Origin, scenario: ScenarioConfiguration
) -> Path:
    """The file of a trace, which is usable and long enough."""
    path = _find(given.file, f"{key}.file", origin)
    if not is_file(path):
        names = sorted(each.stem for each in TRACES.glob("*.parquet"))
        if given.file not in names:
            allowed = f"no such file, nor one of the shipped traces {', '.join(names)}"
            hint = did_you_mean(given.file, names)
            raise ConfigurationError(f"{key}.file", given.file, allowed + hint)
        path = TRACES / f"{given.file}.parquet"
    with _refusing(f"{key}.file", given.file):
        length_s = read_trace(path).length_ns * 1e-9
        if given.loop and length_s * scenario.rate_hz < 1.0:
            raise ValueError(
                f"must last at least one period of the loop, {1 / scenario.rate_hz:g} s, to be"
                f" repeated; it lasts {length_s:g} s (time_s is in seconds)"
            )
    if (start_s := given.start_s) is None:
        return path
    if start_s >= length_s:
        allowed = f"must be below the trace's {length_s:g} s"
        raise ConfigurationError(f"{key}.start_s", start_s, allowed, [f"{key}.file"])
    if not given.loop and start_s + scenario.duration_s > length_s:
        allowed = (
            f"must be true, because the trace lasts only {length_s - start_s:g} s after start_s"
        )
        raise ConfigurationError(f"{key}.loop", given.loop, allowed, ["duration_s"])
    return path


def find_nominal(
    scenario: ScenarioConfiguration, robot: RobotDescription, origin: Origin
) -> tuple[RobotDescription, ControllerConfiguration]:
    """Return the arm as the nominal model has it, and the controller with the path to its file.

    Raises:
        ConfigurationError: the file cannot be read, or has other joints.
    """
    controller = scenario.controller
    if controller.model is None:
        return robot, controller
    with _refusing(MODEL_KEY, controller.model):
        path = find_urdf(controller.model, *folders_of(MODEL_KEY, origin))
        if is_xacro(path):
            raise ValueError("must be a URDF or MJCF file, no xacro file")
        nominal = load_robot(path, robot.joint_names, repair=scenario.robot.repair)
        if nominal.joint_names != robot.joint_names:
            raise ValueError(f"must have the arm's joints in their order: {robot.joint_names}")
    limits = replace(nominal, effort_limits_nm=robot.effort_limits_nm, warnings=())
    return limits, controller.model_copy(update={"model": str(path)})


def find_reference_file(
    reference: ReferenceConfiguration, origin: Origin
) -> ReferenceConfiguration:
    """The reference with an absolute path to its file, if it has one.

    Args:
        reference: the section.
        origin: of the scenario's values.

    Raises:
        ConfigurationError: there is no such file.
    """
    if not isinstance(reference, CsvConfiguration):
        return reference
    path = _find(reference.file, REFERENCE_KEY, origin)
    if not is_file(path):
        allowed = f"no such file; must be a path from {path.parent} or from the current folder"
        raise ConfigurationError(REFERENCE_KEY, reference.file, allowed)
    return reference.model_copy(update={"file": str(path)})


def _find(name: str, key: str, origin: Origin) -> Path:
    """The absolute path that a key names: the first one that is there."""
    candidates = [folder / name for folder in folders_of(key, origin)]
    with _refusing(key, name):
        return next(filter(is_file, candidates), candidates[0]).resolve()


@contextmanager
def _refusing(key: str, value: str) -> Iterator[None]:
    """Add the key that names a file to an error about it."""
    try:
        yield
    except (ValueError, OSError, RuntimeError) as error:  # the last for links in a circle
        raise ConfigurationError(key, value, str(error)) from error


def data_files(scenario: ScenarioConfiguration) -> dict[str, Path]:
    """Return the files of a checked scenario except its arm, by dotted key."""
    named = {key: _value_at(scenario, key) for key in DATA_FILES}
    return {key: Path(file) for key, file in named.items() if file is not None}


def _value_at(section: Any, key: str) -> Any:
    """Return the value of a dotted key; None if a section on the way is missing."""
    for name in key.split("."):
        section = getattr(section, name, None)
    return section


def named_robot(
    name: str, joints: Sequence[str] | None = None, include: Iterable[Path] = (),
    mass_kg: float | None = None,
) -> RobotDescription:  # fmt: skip
    """Return an arm by its file, with xacro arguments, or by the name of a shipped robot.

    Args:
        name: the file or name.
        joints: names of its driven joints; all by default.
        include: folders of packages that the file includes.
        mass_kg: mass of an arm whose file has none.

    Raises:
        ScenarioError: the file is missing, or cannot be used.
    """
    try:
        file, words = split_arguments(name)
        urdf, folders = find_urdf(file, Path.cwd()), [folder.resolve() for folder in include]
        return load_robot(urdf, joints, arguments=words, include=folders, mass_kg=mass_kg)
    except RobotDescriptionError as error:
        text = str(error)
        raise ScenarioError(text if text.startswith("/") else f"{name}: {text}") from error
