import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schema.errors import InvalidMessageError
from bus_schema.messages.layout import MAX_PAYLOAD_BYTES, parse
from bus_schema.messages.record import Record
from bus_schema.messages.topics import (
    CONTROL_STATUS,
    JOINT_COMMANDS,
    JOINT_STATES,
    RUN_EVENTS,
    TOPICS,
    layout,
)
from bus_schema.messages.types import TYPESTORE
from tests.joint_states import joint_state as encoded

FIXED_TOPICS = [topic for topic in TOPICS if topic is not RUN_EVENTS]
LETTERS = st.characters(codec="utf-8", exclude_categories=["C"])  # no NUL, which ends a string
JOINT_NAMES = st.lists(
    st.text(LETTERS, min_size=1, max_size=9), min_size=1, max_size=14, unique=True
)
THREE = ("yaw", "shoulder", "elbow_pitch")
STATE = layout(JOINT_STATES, THREE)


def filled(wire_layout, seed):
    """A record with random bits in every field, NaNs and infinities among them."""
    record, random = Record(wire_layout), np.random.default_rng(seed)
    for name, values in record.fields.items():
        is_flag = name in ("deadline_met", "saturated")
        noise = bytes([seed % 2]) if is_flag else random.bytes(values.nbytes)
        values[:] = np.frombuffer(noise, values.dtype)
        if name.endswith("nanosec"):
            values %= 1_000_000_000
    return record


def numeric_leaves(message, prefix=""):
    """Dotted names of all numbers and non-empty arrays that a rosbags message holds."""
    for name, value in vars(message).items():
        if hasattr(value, "__msgtype__"):
            yield from numeric_leaves(value, f"{prefix}{name}.")
        elif name.islower() and not isinstance(value, str | list) and np.size(value):
            yield prefix + name  # upper case names are constants of the type


def rosbags_message(record, wire_layout):
    """The values of a record as a rosbags message."""
    message = TYPESTORE.deserialize_cdr(wire_layout.template, wire_layout.type_name)
    assert set(numeric_leaves(message)) == set(record.fields)
    for name, values in record.fields.items():
        *path, last = name.split(".")
        owner = message
        for part in path:
            owner = getattr(owner, part)
        is_array = isinstance(getattr(owner, last), np.ndarray)
        setattr(owner, last, values if is_array else values[0].item())
    return message


def joint_state(names=THREE, position=(1.0, 2.0, 3.0), **values):
    return encoded(names, position, **{"stamp_ns": 12_000_000_034, "frame": "", **values})


def rejection(payload, wire_layout=STATE):
    with pytest.raises(InvalidMessageError) as caught:
        wire_layout.decode(payload, Record(wire_layout))
    return caught.value.reason


@pytest.mark.parametrize("topic", FIXED_TOPICS, ids=lambda topic: topic.name)
@settings(max_examples=40)
@given(names=JOINT_NAMES, seed=st.integers(0, 2**32 - 1))
def test_payload_equals_rosbags_bytes_and_decodes_to_itself_in_both_byte_orders(topic, names, seed):
    wire_layout = layout(topic, tuple(names))
    record = filled(wire_layout, seed)
    message = rosbags_message(record, wire_layout)
    assert record.payload() == bytes(TYPESTORE.serialize_cdr(message, topic.type_name))

    big_endian = bytes(TYPESTORE.serialize_cdr(message, topic.type_name, little_endian=False))
    assert big_endian != record.payload()
    for payload in (record.payload(), big_endian):
        decoded = Record(wire_layout)
        wire_layout.decode(payload, decoded)
        for name, values in record.fields.items():
            np.testing.assert_array_equal(decoded.fields[name], values)


@given(order=st.permutations(range(3)), frame=st.sampled_from(["", "x", "world"]))
def test_foreign_joint_state_is_decoded_in_our_joint_order(order, frame):
    payload = joint_state(
        names=[THREE[i] for i in order],
        position=[10.0 + i for i in order],
        velocity=[20.0 + i for i in order],
        effort=[30.0 + i for i in order],
        frame=frame,
    )
    record = Record(STATE)
    assert STATE.decode(payload, record) == 12_000_000_034
    assert record.stamp_ns == 12_000_000_034
    assert record.fields["position"].tolist() == [10.0, 11.0, 12.0]
    assert record.fields["velocity"].tolist() == [20.0, 21.0, 22.0]
    assert record.fields["effort"].tolist() == [30.0, 31.0, 32.0]


def test_empty_velocity_and_effort_are_unknown_not_left_from_the_message_before():
    record = filled(STATE, 1)
    STATE.decode(joint_state(), record)
    assert record.fields["position"].tolist() == [1.0, 2.0, 3.0]
    assert np.isnan(record.fields["velocity"]).all()
    assert np.isnan(record.fields["effort"]).all()


def test_positions_in_a_command_are_ignored():
    commands = layout(JOINT_COMMANDS, THREE)
    record = Record(commands)
    commands.decode(joint_state(effort=(4.0, 5.0, 6.0)), record)
    assert record.fields["effort"].tolist() == [4.0, 5.0, 6.0]
    assert "position" not in record.fields


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (joint_state(names=("yaw", "shoulder", "wrist")), "wrong_names"),
        (joint_state(names=THREE[:2], position=(1.0, 2.0)), "wrong_names"),
        (joint_state(names=(*THREE, "wrist"), position=(1.0, 2.0, 3.0, 4.0)), "wrong_names"),
        (joint_state(names=("yaw", "yaw", "shoulder")), "wrong_names"),
        (joint_state(names=()), "wrong_names"),
        (joint_state(position=(1.0, 2.0)), "wrong_size"),
        (joint_state(velocity=(1.0, 2.0, 3.0, 4.0)), "wrong_size"),
        (joint_state(effort=(1.0,)), "wrong_size"),
        (b"", "malformed"),
        (b"garbage", "malformed"),
        (joint_state().replace(b"yaw\0", b"\xff\xfe\xff\0"), "malformed"),
        (joint_state() + bytes(8), "malformed"),
    ],
)
def test_unusable_joint_states_are_rejected_with_their_reason(payload, reason):
    assert rejection(payload) == reason


def test_largest_payload_is_64_kib():
    filler = MAX_PAYLOAD_BYTES - len(joint_state(frame="")) + 1
    largest = joint_state(frame="x" * (filler // 8 * 8 - 8))
    assert MAX_PAYLOAD_BYTES - 32 < len(largest) <= MAX_PAYLOAD_BYTES == 65_536
    record = Record(STATE)
    STATE.decode(largest, record)
    assert record.fields["position"].tolist() == [1.0, 2.0, 3.0]
    assert rejection(joint_state(frame="x" * 65_536)) == "oversized"
    assert rejection(bytes(65_537)) == "oversized"
    assert rejection(bytes(65_536)) != "oversized"


@pytest.mark.parametrize("topic", FIXED_TOPICS, ids=lambda topic: topic.name)
def test_every_truncation_is_rejected(topic):
    wire_layout = layout(topic, THREE)
    payload = filled(wire_layout, 3).payload()
    for length in range(len(payload)):
        assert rejection(payload[:length], wire_layout) == "malformed"


@pytest.mark.parametrize("count", [0x10000, 0x7FFFFFFF, 0xFFFFFFFF])
def test_claimed_huge_arrays_are_rejected_in_bounded_memory(count):
    # The three counters of an honest payload: string length, number of names, number of positions.
    payload = joint_state()
    claimed = count.to_bytes(4, "little")
    counters = [12, 20, payload.index(np.float64(1.0).tobytes()) - 8]
    counters[2] = next(at for at in (counters[2], counters[2] + 4) if payload[at] == 3)
    tracemalloc.start()
    try:
        for at in counters:
            assert rejection(payload[:at] + claimed + payload[at + 4 :]) == "malformed"
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A payload may be 64 KiB; what its parsing takes may not be of another order.
    assert peak_bytes < 4e6


def bad_stamp():
    record = filled(STATE, 1)
    record.fields["header.stamp.nanosec"][0] = 1_000_000_000
    return record.payload()


OURS = [filled(STATE, seed).payload() for seed in range(4)]
FOREIGN = joint_state(names=THREE[::-1], velocity=(4.0, 5.0, 6.0), effort=(7.0, 8.0, 9.0))
OTHER_NAMES = OURS[0].replace(b"yaw", b"way")


@pytest.mark.parametrize(
    "payloads",
    [[], OURS, [*OURS, FOREIGN], [OURS[0], OTHER_NAMES], [OURS[0], bad_stamp()], [b"", OURS[0]]],
    ids=["none", "ours", "foreign", "other names", "no time", "too short"],
)
def test_table_holds_what_can_be_decoded_one_by_one(payloads):
    rows = []
    for payload in payloads:
        record = Record(STATE)
        try:
            STATE.decode(payload, record)
        except InvalidMessageError:
            continue
        rows.append(record.payload())
    table = STATE.tabulate(payloads)
    assert (table.dtype, table.tobytes()) == (STATE.dtype, b"".join(rows))


@pytest.mark.parametrize("topic", FIXED_TOPICS, ids=lambda topic: topic.name)
def test_every_single_value_is_written_and_read_by_its_name(topic):
    wire_layout = layout(topic, THREE)
    record = Record(wire_layout)
    singles = [name for name, values in record.fields.items() if values.shape == (1,)]
    for value, name in enumerate(singles):
        setattr(record.scalars, name.replace(".", "_"), value % 2)
    message = parse(record.payload(), topic.type_name)
    for value, name in enumerate(singles):
        found = message
        for part in name.split("."):
            found = getattr(found, part)
        assert found == value % 2
        assert getattr(record.scalars, name.replace(".", "_")) == value % 2


def test_rows_are_asked_for_by_name_and_only_as_they_lie():
    # Whoever reorders a .msg file breaks this, not a recording.
    record = Record(layout(CONTROL_STATUS, THREE))
    rows = record.rows("error", "error_rate", "upper_bound")
    rows[:] = np.arange(9.0).reshape(3, 3)
    assert record.fields["error_rate"].tolist() == [3.0, 4.0, 5.0]
    for names in (("error_rate", "error"), ("error", "upper_bound"), ("sequence", "horizon_ns")):
        with pytest.raises(ValueError, match=names[0]):
            record.rows(*names)


@pytest.mark.parametrize("has_targets", [False, True])
def test_a_message_with_rows_is_read_alike_by_its_remembered_layout(has_targets):
    """The first message is parsed by rosbags; the second one by the layout made of it."""
    names, kinds = ("yaw", "elbow"), {"has_targets": has_targets, "has_acting_time": True}
    one = layout(JOINT_COMMANDS, names, **kinds)
    wide = layout(JOINT_COMMANDS, names, **kinds, rows=3, row_ticks=50)
    sent = Record(wide)
    sent.stamp_ns, sent.acts_after_ns = 1_000_000_007, 48_000_000
    for number, values in enumerate(sent.fields.values()):
        if values.size == 6:
            values[:] = np.arange(6.0) + 10.0 * number
    parsed, remembered = Record(one), Record(one)
    one.decode(sent.payload(), parsed)
    assert one.decode(sent.payload(), remembered) == 1_000_000_007
    assert remembered.payload() == parsed.payload()
    assert remembered.later.tobytes() == parsed.later.tobytes()
    assert remembered.fields["effort"].tolist() == sent.fields["effort"][:2].tolist()
    assert (remembered.acts_after_ns, remembered.row_ticks) == (48_000_000, 50)
    damaged = sent.payload().replace(b"=0048000000", b"=004800000x")
    with pytest.raises(InvalidMessageError):
        one.decode(damaged, remembered)
    other = sent.payload().replace(b"row_ticks=50", b"row_ticks=25")  # of the same length
    one.decode(other, remembered)
    assert remembered.row_ticks == 25
