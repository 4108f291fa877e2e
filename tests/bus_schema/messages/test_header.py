import numpy as np
import pytest

from bus_schema.messages.record import Record
from bus_schema.messages.topics import PLANT_TRUTH, layout
from bus_schema.messages.types import join_stamp, split_stamp, stamp_of, stamps_ns, with_stamp

LAYOUT = layout(PLANT_TRUTH, ("yaw", "elbow"))


def message(stamp_ns):
    record = Record(LAYOUT)
    record.stamp_ns = stamp_ns
    return record.payload()


@pytest.mark.parametrize("stamp_ns", [0, 1, 999_999_999, 1_000_000_000, 7_000_000_009])
def test_a_stamp_is_the_same_however_it_is_read(stamp_ns):
    assert join_stamp(*split_stamp(stamp_ns)) == stamp_ns
    assert stamp_of(message(stamp_ns)) == stamp_ns
    assert stamp_of(with_stamp(message(5), stamp_ns)) == stamp_ns
    assert with_stamp(message(5), stamp_ns) == message(stamp_ns)


def test_stamps_of_a_table_do_not_lose_nanoseconds():
    stamps = [0, 2_000_000_000_000_000_001]
    table = LAYOUT.tabulate([message(stamp_ns) for stamp_ns in stamps])
    assert stamps_ns(table).tolist() == stamps
    assert stamps_ns(table).dtype == np.int64


@pytest.mark.parametrize(
    "payload", [b"", b"\0\1\0\0\2\0\0\0\3\0\0", b"\0\1\0\0\xff\xff\xff\xff\0\0\0\0"]
)
def test_what_has_no_stamp_since_the_start_has_none(payload):
    assert stamp_of(payload) is None
