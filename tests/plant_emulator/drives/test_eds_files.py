"""Descriptions of drives that are none."""

import os

import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CIA402_EDS, CanConfiguration
from plant_emulator.drives.cia402.protocol import Cia402Protocol


@pytest.mark.parametrize("kind", ["fifo", "device", "negative type"])
def test_a_file_that_is_no_eds_is_refused(tmp_path, kind):
    path = tmp_path / "drive.eds"
    match kind:
        case "fifo":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case _:
            path.write_text(CIA402_EDS.read_text().replace("DataType=0x0007", "DataType=-7"))
    with pytest.raises(ConfigurationError, match=r"is no regular file|has data type -7"):
        Cia402Protocol().check(CanConfiguration(eds=str(path)))
