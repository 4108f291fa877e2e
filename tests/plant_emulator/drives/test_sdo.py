"""The SDO server: every abort code that the dictionary can give (CiA 301, table 22), and no other
way out of a bad request."""

import struct

import pytest
from drive_bench import NODE, AbortedError, Bench

NAME = 0x1008
RPDO_1, RPDO_3, TPDO_1, TPDO_3 = 0x1400, 0x1402, 0x1800, 0x1802
NOT_VALID = 1 << 31


@pytest.fixture
def bench():
    return Bench()


def aborted(call, *args, **kwargs):
    with pytest.raises(AbortedError) as caught:
        call(*args, **kwargs)
    return caught.value.args[0]


def request(command, index=0, subindex=0, value=0):
    return struct.pack("<BHBI", command, index, subindex, value)


@pytest.mark.parametrize(
    ("code", "index", "subindex", "value", "size"),
    [
        (0x06010002, 0x1000, 0, 1, 4),  # write to what is read only
        (0x06010002, 0x1008, 0, 1, 4),  # a constant
        (0x06010002, 0x6041, 0, 1, 2),
        (0x06020000, 0x5FFF, 0, 1, 4),  # no such object
        (0x06020000, RPDO_1 + 4, 1, 0, 4),
        (0x06070010, 0x6040, 0, 6, 4),  # length of a UNSIGNED16
        (0x06070010, 0x6060, 0, 10, 2),
        (0x06090011, 0x6040, 1, 6, 2),  # a variable has sub-index 0 only
        (0x06090011, 0x607D, 3, 6, 4),
        (0x06090011, RPDO_1, 4, 6, 4),  # reserved (CiA 301, 7.5.2.35)
        (0x06090030, 0x6060, 0, 9, 1),  # a mode that 0x6502 does not name
        (0x06090030, 0x6060, 0, -1, 1),
        (0x06090030, 0x1003, 0, 1, 1),  # only 0 clears the history
        (0x06090030, TPDO_1, 2, 241, 1),  # reserved transmission type
        (0x06090030, TPDO_1, 2, 252, 1),  # RTR only: not supported
        (0x06090030, RPDO_1, 1, 0x201 + NODE, 4),  # moved while it exists
        (0x06090030, RPDO_3, 1, 0x20000400, 4),  # extended frames
        (0x06090030, RPDO_3, 1, 0x581, 4),  # restricted identifier (table 40)
        (0x06090030, TPDO_1, 3, 10, 2),  # inhibit time while it exists
        (0x06090030, 0x1005, 0, 0x40000080, 4),  # it cannot produce SYNC
        (0x06090030, 0x1005, 0, 0x605, 4),
        (0x06090030, 0x1014, 0, 0x90, 4),  # EMCY moved while it is valid
        (0x06090031, 0x605A, 0, 9, 2),  # above the dictionary's limit
        (0x06090031, 0x1029, 1, 3, 1),
        (0x06090032, 0x605D, 0, 0, 2),  # below it
        (0x06090032, 0x6007, 0, -1, 2),
        (0x06090036, 0x607D, 1, 1 << 30, 4),  # minimum above maximum
        (0x06010000, 0x1600, 0, 0, 1),  # mapping of a PDO that exists
        (0x06010000, 0x1600, 1, 0x60400010, 4),
        (0x06040042, 0x1602, 0, 9, 1),  # more entries than there can be
    ],
)
def test_writes_that_are_refused(bench, code, index, subindex, value, size):
    bench.write(0x607D, 2, 1 << 20)
    assert aborted(bench.write, index, subindex, value, size) == code


@pytest.mark.parametrize(
    ("code", "entry"),
    [
        (0x06020000, 0x5FFF0020),  # no such object
        (0x06020000, 0x607D0320),  # no such sub-index
        (0x06040041, 0x10170010),  # the dictionary does not let it be mapped
        (0x06040041, 0x60400020),  # not its length
        (0x06040041, 0x60410010),  # cannot be received
        (0x06020000, 0x00050008),  # dummy entries are not supported (DummyUsage in the EDS)
    ],
)
def test_objects_that_cannot_be_mapped_into_an_rpdo(bench, code, entry):
    bench.write(0x1602, 0, 0)  # it is switched off, but something is mapped
    assert aborted(bench.write, 0x1602, 1, entry) == code


def test_a_mapping_beyond_64_bits_is_refused(bench):
    bench.write(TPDO_3, 1, NOT_VALID | 0x380 + NODE)
    bench.write(0x1A02, 0, 0)
    for subindex, entry in enumerate((0x60640020, 0x606C0020, 0x60410010), start=1):
        bench.write(0x1A02, subindex, entry)
    assert aborted(bench.write, 0x1A02, 0, 3) == 0x06040042
    bench.write(0x1A02, 0, 2)


def test_two_watched_heartbeats_of_one_node_are_incompatible(bench):
    bench.write(0x1016, 1, 0x7F << 16 | 100)
    assert aborted(bench.write, 0x1016, 2, 0x7F << 16 | 200) == 0x06040043
    bench.write(0x1016, 2, 0x7E << 16 | 200)


@pytest.mark.parametrize(
    ("code", "index", "subindex"),
    [(0x06020000, 0x1004, 0), (0x06090011, 0x1018, 5), (0x06090011, 0x6041, 1),
     (0x06090011, 0x1016, 3), (0x08000024, 0x1003, 1)],
)  # fmt: skip
def test_reads_that_are_refused(bench, code, index, subindex):
    assert aborted(bench.read, index, subindex) == code


def test_segments_alternate_their_toggle_bit(bench):
    bench.sdo(request(0x40, NAME))
    bench.sdo(request(0x60))
    assert aborted(bench.sdo, request(0x60)) == 0x05030000
    assert aborted(bench.sdo, request(0x70)) == 0x05040001  # that transfer is over


def test_a_name_is_read_in_segments(bench):
    answer = bench.sdo(request(0x40, NAME))
    assert answer[0] == 0x41
    size = struct.unpack_from("<I", answer, 4)[0]
    text, toggle = b"", 0
    while True:
        answer = bench.sdo(request(0x60 | toggle))
        text += answer[1 : 8 - (answer[0] >> 1 & 7)]
        if answer[0] & 1:
            break
        toggle ^= 0x10
    assert text == b"funnel-hil servo drive"
    assert size == len(text)


@pytest.mark.parametrize("command", [0x00, 0x60, 0xE0, 0xC0])
def test_what_was_never_begun_or_does_not_exist_is_an_unknown_command(bench, command):
    """Segments of no transfer, command 7, block download."""
    assert aborted(bench.sdo, request(command)) == 0x05040001


def test_a_download_without_end_is_cut_off(bench):
    bench.sdo(request(0x20, 0x6071))
    toggle = 0
    for _ in range(9):
        bench.sdo(bytes([toggle]) + bytes(7))
        toggle ^= 0x10
    for _ in range(1):
        bench.sdo(bytes([toggle]) + bytes(7))
        toggle ^= 0x10
    assert aborted(bench.sdo, bytes([toggle]) + bytes(7)) == 0x05040005


def test_a_download_in_one_segment(bench):
    bench.sdo(request(0x21, 0x6071, value=2))
    bench.sdo(bytes([0x0B]) + struct.pack("<h", -300) + bytes(5))
    assert bench.read(0x6071, signed=True) == -300


def test_a_segmented_download_must_have_the_length_of_the_object(bench):
    bench.sdo(request(0x20, 0x6071))
    assert aborted(bench.sdo, bytes([0x09]) + bytes(7)) == 0x06070010


def test_a_download_to_what_is_read_only_is_refused_at_once(bench):
    assert aborted(bench.sdo, request(0x21, 0x1000, value=100)) == 0x06010002


def test_an_expedited_download_may_leave_its_size_to_the_object(bench):
    bench.sdo(request(0x22, 0x6071, value=0xFFFF0064))
    assert bench.read(0x6071) == 100


def test_block_upload_falls_back_to_a_normal_one(bench):
    """CiA 301, 7.2.4.3.15: the server may switch to the upload protocol."""
    assert bench.sdo(request(0xA0, 0x1000))[0] == 0x43


def test_an_abort_from_the_client_ends_the_transfer_without_answer(bench):
    bench.sdo(request(0x40, NAME))
    assert bench.sdo(request(0x80, NAME)) is None
    assert aborted(bench.sdo, request(0x60)) == 0x05040001


def test_a_stopped_node_serves_no_sdo(bench):
    bench.hear(0, 2, NODE)
    assert bench.sdo(request(0x40, 0x1000)) is None
