"""Files that a scenario refers to: the arm's URDF, and files of delays and of the reference."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import RobotDescriptionError, did_you_mean
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.urdf.resolved import pybullet_data
from bus_schema.user_files import is_file
from controller.reference_configuration import CsvConfiguration, ReferenceConfiguration
from controller.reference_file import KEY as REFERENCE_KEY
from deploy.scenario.definition import ScenarioConfiguration
from plant_emulator.channel.jitter import read_delays_ms

DIRECTIONS = ("uplink", "downlink")
DELAY_KEYS = tuple(f"link.{direction}.distribution_file" for direction in DIRECTIONS)
ROBOTS = Path(str(resources.files("deploy").joinpath("robots")))
_PYBULLET_DATA = "pybullet_data:"


def find_urdf(name: str, base: Path) -> Path:
    """Return the URDF file that a scenario names.

    Args:
        name: a path relative to `base`, the name of a shipped robot, or ``pybullet_data:`` with a
            path inside that package.
        base: folder of the scenario.

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
        candidates = [base / name, ROBOTS / f"{name}.urdf"]
    for candidate in candidates:
        if is_file(candidate):
            return candidate.resolve()
    shipped = sorted(path.stem for path in ROBOTS.glob("*.urdf"))
    raise RobotDescriptionError(
        f"no such file; allowed are a path from {base}, a shipped robot ({', '.join(shipped)}), or"
        f" {_PYBULLET_DATA}<path in the package pybullet_data>{did_you_mean(name, shipped)}"
    )


def find_delay_files(link: LinkConfiguration, base: Path) -> LinkConfiguration:
    """Return the link with absolute paths to its files of delays, after checking them.

    Args:
        link: the section.
        base: folder of the scenario.

    Raises:
        ConfigurationError: a file does not exist or is invalid.
    """
    for direction in DIRECTIONS:
        channel = getattr(link, direction)
        if channel.distribution_file is None:
            continue
        try:
            path = (base / channel.distribution_file).resolve()
            read_delays_ms(path)
        except (ValueError, OSError, RuntimeError) as error:  # the last for circular links
            key = f"link.{direction}.distribution_file"
            raise ConfigurationError(key, channel.distribution_file, str(error)) from error
        found = channel.model_copy(update={"distribution_file": str(path)})
        link = link.model_copy(update={direction: found})
    return link


def find_reference_file(reference: ReferenceConfiguration, base: Path) -> ReferenceConfiguration:
    """Return the reference with an absolute path to its file, if it has one.

    Args:
        reference: the section.
        base: folder of the scenario; a path may also start at the current one.

    Raises:
        ConfigurationError: there is no such file.
    """
    if not isinstance(reference, CsvConfiguration):
        return reference
    for candidate in (base / reference.file, Path(reference.file)):
        if is_file(candidate):
            return reference.model_copy(update={"file": str(candidate.resolve())})
    allowed = f"no such file; must be a path from {base} or from the current folder"
    raise ConfigurationError(REFERENCE_KEY, reference.file, allowed)


def data_files(scenario: ScenarioConfiguration) -> dict[str, Path]:
    """Return the files of a checked scenario except its arm's, by dotted key."""
    named = {key: getattr(scenario.link, key.split(".")[1]).distribution_file for key in DELAY_KEYS}
    if isinstance(scenario.reference, CsvConfiguration):
        named[REFERENCE_KEY] = scenario.reference.file
    return {key: Path(file) for key, file in named.items() if file is not None}
