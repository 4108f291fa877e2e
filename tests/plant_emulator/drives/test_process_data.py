"""PDOs: when they are sent, take effect, and how a master maps them (CiA 301, 7.2.2)."""

import struct

import pytest
from drive_bench import ENABLE, NODE, SHUTDOWN, Bench

from bus_schema.errors import InvalidMessageError

SYNC, EMCY = 0x80, 0x80 + NODE
RPDO_1, TPDO_1, TPDO_2, TPDO_3 = 0x200 + NODE, 0x180 + NODE, 0x280 + NODE, 0x380 + NODE
NOT_VALID = 1 << 31


@pytest.fixture
def bench():
    made = Bench()
    made.start()
    return made


def remap(bench, communication, mapping, *entries, kind=None, cob_id=None):
    """The procedure of CiA 301, 7.5.2.36."""
    cob_id = bench.read(communication, 1) & ~NOT_VALID if cob_id is None else cob_id
    bench.write(communication, 1, cob_id | NOT_VALID)
    if kind is not None:
        bench.write(communication, 2, kind)
    bench.write(mapping, 0, 0)
    for subindex, entry in enumerate(entries, start=1):
        bench.write(mapping, subindex, entry)
    bench.write(mapping, 0, len(entries))
    bench.write(communication, 1, cob_id)
    bench.take()


def test_sync_samples_position_and_velocity(bench):
    bench.move(position_rad=1.0, velocity_rad_s=-0.5)
    bench.hear(SYNC)
    # 2^20 increments per turn: 1 rad is 166886.1, 0.5 rad/s 83443.03 increments (per second)
    assert bench.take(TPDO_1) == [struct.pack("<ii", 166886, -83443)]
    assert bench.drive.samplings == 1


def test_nothing_goes_or_comes_before_operational():
    bench = Bench()
    bench.hear(SYNC)
    bench.control(SHUTDOWN)
    assert bench.take() == []
    assert bench.state == "SWITCH_ON_DISABLED"


def test_an_event_driven_tpdo_goes_when_it_starts_and_when_it_changes(bench):
    fresh = Bench()
    fresh.hear(0, 1, 0)
    assert [data[:3] for data in fresh.take(TPDO_2)] == [b"\x50\x02\x00"]
    fresh.wait(10)
    assert fresh.take(TPDO_2) == []
    fresh.wait(90)  # its event timer: BaseNode402 takes what came twice for periodic
    assert len(fresh.take(TPDO_2)) == 1
    fresh.control(SHUTDOWN)
    assert [data[:2] for data in fresh.take(TPDO_2)] == [b"\x31\x02"]


def test_the_inhibit_time_keeps_them_apart(bench):
    remap(bench, 0x1801, 0x1A01, 0x60640020)
    bench.write(0x1801, 1, NOT_VALID | TPDO_2)
    bench.write(0x1801, 3, 100)  # 10 ms
    bench.write(0x1801, 1, TPDO_2)
    bench.take()
    count = 0
    for tick in range(100):
        bench.move(position_rad=tick * 1e-3)
        bench.wait(1)
        count += len(bench.take(TPDO_2))
    assert count == 10


@pytest.mark.parametrize(("kind", "expected"), [(1, 12), (3, 4), (240, 0)])
def test_a_synchronous_tpdo_goes_every_nth_sync(bench, kind, expected):
    bench.write(0x1800, 2, kind)
    for _ in range(12):
        bench.hear(SYNC)
    assert len(bench.take(TPDO_1)) == expected


def test_a_synchronous_rpdo_comes_into_force_with_the_next_sync(bench):
    bench.write(0x1400, 2, 1)
    bench.control(SHUTDOWN)
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.hear(SYNC)
    assert bench.state == "READY_TO_SWITCH_ON"


def test_a_sync_with_a_counter_is_an_error_8240(bench):
    with pytest.raises(InvalidMessageError):
        bench.hear(SYNC, 1)
    assert bench.take(EMCY)[0][:2] == b"\x40\x82"
    bench.hear(SYNC)
    assert bench.take(EMCY)[0][:2] == b"\0\0"


def test_remapping_over_sdo(bench):
    remap(bench, 0x1802, 0x1A02, 0x60770010, 0x60410010, 0x60610008, kind=1)
    bench.move(torque_nm=-5.0)
    bench.hear(SYNC)
    assert bench.take(TPDO_3) == [struct.pack("<hHb", -250, 0x0250, 0)]


def test_remapped_rpdo_writes_the_mapped_objects(bench):
    remap(bench, 0x1402, 0x1602, 0x60710010, 0x60B20010, kind=255)
    bench.hear(0x400 + NODE, *struct.pack("<hh", 100, -30))
    assert bench.read(0x6071) == 100
    assert bench.read(0x60B2, signed=True) == -30
    assert bench.drive.targets == 1


@pytest.mark.parametrize(("length", "code"), [(3, 0x8210), (0, 0x8210), (5, 0x8220), (8, 0x8220)])
def test_rpdo_of_wrong_length_is_reported_once_and_changes_nothing(bench, length, code):
    frame = (struct.pack("<Hh", SHUTDOWN, 100) + bytes(4))[:length]
    for _ in range(3):
        with pytest.raises(InvalidMessageError):
            bench.hear(RPDO_1, *frame)
    assert [data[:2] for data in bench.take(EMCY)] == [code.to_bytes(2, "little")]
    assert bench.state == "SWITCH_ON_DISABLED"
    assert bench.drive.targets == 0
    bench.control(SHUTDOWN)
    assert [data[:2] for data in bench.take(EMCY)] == [b"\0\0"]


def test_bootup_and_heartbeat():
    bench = Bench(boot=False)
    bench.wait(0)
    assert bench.take(0x700 + NODE) == [b"\0"]
    bench.wait(1000)
    assert bench.take(0x700 + NODE) == [b"\x7f"] * 10  # 0x1017 is 100 ms
    bench.write(0x1017, 0, 30)
    bench.start()
    bench.wait(90)
    assert bench.take(0x700 + NODE) == [b"\x05"] * 3
    bench.write(0x1017, 0, 0)
    bench.take()
    bench.wait(1000)
    assert bench.take(0x700 + NODE) == []


def test_nmt_commands_to_others_and_unknown_ones_change_nothing(bench):
    bench.hear(0, 128, NODE + 1)
    for data in ((99, 0), (1,), (1, 0, 0), ()):
        with pytest.raises(InvalidMessageError):
            bench.hear(0, *data)
    bench.control(SHUTDOWN)
    assert bench.state == "READY_TO_SWITCH_ON"  # still operational


def test_master_moves_and_disables_emcy(bench):
    bench.write(0x1014, 0, NOT_VALID | EMCY)
    bench.write(0x1014, 0, 0xF0)
    bench.take()
    with pytest.raises(InvalidMessageError):
        bench.hear(RPDO_1, 1)
    assert len(bench.take(0xF0)) == 1
    bench.write(0x1014, 0, NOT_VALID | 0xF0)
    bench.take()
    bench.control(ENABLE)
    assert bench.take(0xF0) == []
