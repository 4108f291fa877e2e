"""Files that the section ``link`` of a scenario refers to."""

from __future__ import annotations

from pathlib import Path

from bus_schema.configuration import ConfigurationError
from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.jitter import read_delays_ms

DIRECTIONS = ("uplink", "downlink")


def find_delay_files(link: LinkConfiguration, base: Path) -> LinkConfiguration:
    """The link with absolute paths to its files of delays, which are known to be usable.

    Args:
        link: the section.
        base: folder of the scenario.

    Raises:
        ConfigurationError: a file is not there or holds something else.
    """
    for direction in DIRECTIONS:
        channel = getattr(link, direction)
        if channel.distribution_file is None:
            continue
        path = (base / channel.distribution_file).resolve()
        try:
            read_delays_ms(path)
        except ValueError as error:
            key = f"link.{direction}.distribution_file"
            raise ConfigurationError(key, channel.distribution_file, str(error)) from error
        found = channel.model_copy(update={"distribution_file": str(path)})
        link = link.model_copy(update={direction: found})
    return link


def delay_files(link: LinkConfiguration) -> dict[str, Path]:
    """The files of delays by direction; empty where no delay is drawn from one."""
    files = {direction: getattr(link, direction).distribution_file for direction in DIRECTIONS}
    return {direction: Path(file) for direction, file in files.items() if file is not None}
