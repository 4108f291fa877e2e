"""Files that a scenario refers to: the arm's URDF, and files of delays and of the reference."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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
from deploy.scenario.explanation import Origin
from plant_emulator.channel.jitter import read_delays_ms

DIRECTIONS = ("uplink", "downlink")
DELAY_KEYS = tuple(f"link.{direction}.distribution_file" for direction in DIRECTIONS)
ROBOTS = Path(str(resources.files("deploy").joinpath("robots")))
_PYBULLET_DATA = "pybullet_data:"


def folders_of(key: str, origin: Origin) -> tuple[Path, Path]:
    """Where a relative path of a scenario may start, the likelier folder first.

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
    shipped = sorted(path.stem for path in ROBOTS.glob("*.urdf"))
    raise RobotDescriptionError(
        f"no such file; allowed are a path from {bases[0]}, a shipped robot ({', '.join(shipped)}),"
        f" or {_PYBULLET_DATA}<path in the package pybullet_data>{did_you_mean(name, shipped)}"
    )


def find_delay_files(link: LinkConfiguration, origin: Origin) -> LinkConfiguration:
    """The link with absolute paths to its files of delays, which are known to be usable.

    Args:
        link: the section.
        origin: of the scenario's values.

    Raises:
        ConfigurationError: a file is not there or holds something else.
    """
    for direction in DIRECTIONS:
        channel = getattr(link, direction)
        if channel.distribution_file is None:
            continue
        key = f"link.{direction}.distribution_file"
        path = _find(channel.distribution_file, key, origin)
        with _refusing(key, channel.distribution_file):
            read_delays_ms(path)
        found = channel.model_copy(update={"distribution_file": str(path)})
        link = link.model_copy(update={direction: found})
    return link


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
    """What is wrong with a file is told with the key that names it."""
    try:
        yield
    except (ValueError, OSError, RuntimeError) as error:  # the last for links in a circle
        raise ConfigurationError(key, value, str(error)) from error


def data_files(scenario: ScenarioConfiguration) -> dict[str, Path]:
    """The files of a checked scenario but for its arm, by dotted key."""
    named = {key: getattr(scenario.link, key.split(".")[1]).distribution_file for key in DELAY_KEYS}
    if isinstance(scenario.reference, CsvConfiguration):
        named[REFERENCE_KEY] = scenario.reference.file
    return {key: Path(file) for key, file in named.items() if file is not None}
