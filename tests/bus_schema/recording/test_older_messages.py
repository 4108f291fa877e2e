"""Recordings of older versions: what was in their messages is still there."""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bus_schema.messages import topics
from bus_schema.messages.layout import Record
from bus_schema.messages.types import CONTROL_STATUS, JOINT_STATE, TYPESTORE, schema_text
from bus_schema.recording.older_messages import translation

NEWER = ("learned_viscous", "inertia_factor", "payload_kg", "actuator_lag_s", "horizon_ns")
LAYOUT = topics.layout(topics.CONTROL_STATUS, ("a", "b"))


def older_schema():
    lines = schema_text(CONTROL_STATUS).splitlines()
    kept = [line for line in lines if line.split(" ")[-1] not in NEWER]
    assert len(kept) == len(lines) - len(NEWER)
    return "\n".join([*kept, ""])


def older_payload():
    """A message of the older type with all it has set to something."""
    record = Record(LAYOUT)
    record.stamp_ns = 1_500_000_000
    record.scalars.timing_cycle = 7
    record.scalars.network_norm = 2.5
    record.fields["learned_friction"][:] = 3.0, 4.0
    message = TYPESTORE.deserialize_cdr(record.payload(), CONTROL_STATUS)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(older_schema(), CONTROL_STATUS))
    older = store.types[CONTROL_STATUS]
    values = {name: getattr(message, name) for name, _ in store.fielddefs[CONTROL_STATUS][1]}
    return bytes(store.serialize_cdr(older(**values), CONTROL_STATUS))


def test_older_message_keeps_what_it_says_and_leaves_open_what_it_does_not():
    older = older_payload()
    assert not LAYOUT.tabulate([older]).size  # by itself it is no message of today's
    today = translation(CONTROL_STATUS, older_schema())
    (row,) = LAYOUT.tabulate([today(older)])
    assert (row["header.stamp.sec"], row["header.stamp.nanosec"]) == (1, 500_000_000)
    assert (row["timing.cycle"], row["network_norm"], row["horizon_ns"]) == (7, 2.5, 0)
    assert row["learned_friction"].tolist() == [3.0, 4.0]
    assert np.isnan(row["learned_viscous"]).all()
    assert np.isnan([row["inertia_factor"], row["payload_kg"], row["actuator_lag_s"]]).all()


def test_only_what_is_ours_and_older_is_touched():
    assert translation(CONTROL_STATUS, schema_text(CONTROL_STATUS)) is None
    assert translation(JOINT_STATE, "float64 x\n") is None
    assert translation("other_msgs/msg/Thing", "float64 x\n") is None
    assert translation(CONTROL_STATUS, "no schema at all {") is None


def test_payload_of_no_type_stays_as_it_is():
    today = translation(CONTROL_STATUS, older_schema())
    for payload in (b"", b"junk", older_payload()[:40]):
        assert today(payload) == payload
