"""The EDS and the DBC that are shipped say what the drives do."""

import os
from dataclasses import replace

import canopen
import cantools
import pytest
from canopen.objectdictionary import NUMBER_TYPES, ODVariable
from drive_bench import NODE, SETTINGS, AbortedError, Bench

from bus_schema.can.cia402.protocol import Cia402Protocol
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import (
    CANSIMPLE_DBC,
    CIA402_EDS,
    CanConfiguration,
    CanSimpleConfiguration,
)
from plant_emulator.drives.cansimple.drive import CanSimpleDrive

DICTIONARY = canopen.import_od(str(CIA402_EDS), NODE)
HISTORY = 0x1003


def variables():
    for index in DICTIONARY:
        entry = DICTIONARY[index]
        members = [entry] if isinstance(entry, ODVariable) else entry.subindices.values()
        yield from members


@pytest.mark.parametrize("variable", list(variables()), ids=lambda v: f"{v.index:04X}:{v.subindex}")
def test_every_object_is_served_with_its_type(variable):
    bench = Bench()
    if variable.index == HISTORY and variable.subindex > 0:
        with pytest.raises(AbortedError, match=str(0x08000024)):  # no error has happened yet
            bench.read(variable.index, variable.subindex)
    elif variable.data_type in NUMBER_TYPES:
        answer = bench.sdo(bytes([0x40, *variable.index.to_bytes(2, "little"), variable.subindex])
                           + bytes(4))  # fmt: skip
        assert 8 * (4 - (answer[0] >> 2 & 3)) == len(variable)
        assert bytes(answer[1:4]) == variable.index.to_bytes(2, "little") + bytes(
            [variable.subindex]
        )
    else:
        assert bench.sdo(bytes([0x40, *variable.index.to_bytes(2, "little"), 0]) + bytes(4))


@pytest.mark.parametrize("variable", list(variables()), ids=lambda v: f"{v.index:04X}:{v.subindex}")
def test_access_is_what_the_dictionary_says(variable):
    bench = Bench()
    if variable.writable or variable.data_type not in NUMBER_TYPES:
        return
    with pytest.raises(AbortedError, match=str(0x06010002)):
        bench.write(variable.index, variable.subindex, 0, len(variable) // 8)


def test_mandatory_objects_of_the_profiles_are_there():
    """CiA 301: 1000, 1001, 1018; CiA 402-2 for cyclic synchronous torque and position: the rest."""
    wanted = {0x1000, 0x1001, 0x1018, 0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071,
              0x6072, 0x6077, 0x607A, 0x6502}  # fmt: skip
    assert wanted <= set(DICTIONARY)
    bench = Bench()
    assert bench.read(0x1000) == 0x00020192  # servo drive, profile 402
    assert bench.read(0x6502) == 1 << 9 | 1 << 7  # cyclic torque and position alone


def test_the_drive_says_how_it_is_commissioned():
    bench = Bench()
    assert bench.read(0x6076) == 20_000  # mN m
    assert bench.read(0x6072) == 3_000  # 60 of 20 N m
    assert bench.read(0x608F, 1) == SETTINGS.counts_per_turn
    assert bench.read(0x1018, 4) == NODE
    assert bench.read(0x1200, 1) == 0x600 + NODE


NOT_THERE = {
    "RxSdo", "TxSdo", "Set_Traj_Vel_Limit", "Set_Traj_Accel_Limits", "Set_Traj_Inertia",
    "Enter_DFU_Mode",
}  # fmt: skip
"""What this axis refuses: see test_cansimple.py."""


@pytest.mark.parametrize(
    "message",
    [
        each for each in cantools.database.load_file(CANSIMPLE_DBC).messages
        if each.name not in NOT_THERE
    ],
    ids=lambda m: m.name,
)  # fmt: skip
def test_an_axis_knows_every_other_message_of_the_dbc(message):
    bench = Bench(CanSimpleDrive, replace(SETTINGS, own=CanSimpleConfiguration()))
    identifier = NODE << 5 | message.frame_id
    if "Axis" in message.senders:
        bench.hear(identifier, remote=True)
        (data,) = bench.take(identifier)
        assert len(data) == message.length
        message.decode(data)
    elif message.name != "Reboot":
        assert bench.hear(identifier, *bytes(message.length))


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
    with pytest.raises(ConfigurationError, match=r"is not a regular file|has data type -7"):
        Cia402Protocol().check(CanConfiguration(eds=str(path)), takes_targets=True)
