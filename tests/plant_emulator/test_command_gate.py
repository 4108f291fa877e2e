import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.link.interface import CommandArrival
from bus_schema.messages.record import Record
from bus_schema.messages.topics import JOINT_COMMANDS, layout
from bus_schema.messages.types import TYPESTORE
from plant_emulator.command_gate import CommandGate
from tests.joint_states import joint_state

NAMES = ("yaw", "shoulder", "elbow")
NEWEST_NS = 1_000_000


def payload(stamp_ns, torque=(1.0, 2.0, 3.0), names=NAMES):
    record = Record(layout(JOINT_COMMANDS, names))
    record.stamp_ns = stamp_ns
    record.fields["effort"][:] = torque
    return record.payload()


class Bench:
    def __init__(self, *, takes_targets=False):
        self.gone = set()
        self.gate = CommandGate(NAMES, self.gone.__contains__, takes_targets=takes_targets)
        self.rejected = self.gate.rejections.counts
        self.sent = 0

    def admit(self, data, newest_state_ns=NEWEST_NS, sequence=None, sender=b"sender"):
        """Send a command under the next number, or under the one given."""
        self.sent += 1
        number = self.sent if sequence is None else sequence
        return self.gate.admit(CommandArrival(data, number, sender, 0), newest_state_ns)


def aimed(stamp_ns, position=(0.1, 0.2, 0.3), velocity=(-1.0, 0.0, 1.0)):
    """A command with a target for the drives."""
    record = Record(layout(JOINT_COMMANDS, NAMES, has_targets=True))
    record.stamp_ns = stamp_ns
    record.fields["effort"][:] = (1.0, 2.0, 3.0)
    record.fields["position"][:], record.fields["velocity"][:] = position, velocity
    return record.payload()


def foreign(names, effort, stamp_ns=5, position=(), velocity=()):
    return joint_state(names, position, velocity, effort, stamp_ns=stamp_ns)


def test_valid_command_comes_through():
    bench = Bench()
    bench.gate.await_answer(5)
    command = bench.admit(payload(5))
    assert command.torque_nm.tolist() == [1.0, 2.0, 3.0]
    assert (command.sequence, command.stamp_ns) == (1, 5)
    assert not bench.gate.is_waiting
    assert not bench.rejected


REJECTIONS = [
    (b"", "malformed"),
    (b"not a message at all", "malformed"),
    (payload(6)[:-1], "malformed"),
    (bytes(65 * 1024), "oversized"),
    (payload(6, names=("yaw", "shoulder", "wrist")), "wrong_names"),
    (payload(6, (1.0, 2.0), NAMES[:2]), "wrong_names"),
    (foreign(NAMES, (1.0, 2.0)), "wrong_size"),
    (foreign(NAMES, np.ones(7)), "wrong_size"),
    (foreign(NAMES, np.ones(3 * 3000)), "oversized"),
    (foreign(NAMES, ()), "not_finite"),
    (foreign(NAMES, (1.0, 2.0, 3.0, 4.0, np.nan, 6.0)), "not_finite"),
    (payload(6, (np.nan, 0.0, 0.0)), "not_finite"),
    (payload(6, (0.0, 0.0, -np.inf)), "not_finite"),
    (payload(NEWEST_NS + 1), "from_the_future"),
    (payload(5), "stale"),  # answers what was answered already
    (payload(4), "stale"),
]


@pytest.mark.parametrize(("data", "reason"), REJECTIONS, ids=[reason for _, reason in REJECTIONS])
def test_rejected_command_is_counted_and_changes_nothing(data, reason):
    bench = Bench()
    assert bench.admit(payload(5)) is not None
    bench.gate.await_answer(4)
    assert bench.admit(data) is None
    assert bench.rejected == {reason: 1}
    # In lockstep the plant waits for an answer to its state: a late one is one, garbage is none.
    assert bench.gate.is_waiting == (data != payload(4))
    after = bench.admit(payload(6, (4.0, 5.0, 6.0)))
    assert (after.torque_nm.tolist(), after.stamp_ns) == ([4.0, 5.0, 6.0], 6)


def test_second_sender_is_ignored_until_the_commander_has_left():
    bench = Bench()
    assert bench.admit(payload(5), sender=b"first") is not None
    assert bench.admit(payload(6), sender=b"second") is None
    assert bench.rejected == {"other_commander": 1}
    bench.gone.add(b"first")
    assert bench.admit(payload(7), sender=b"second", sequence=1) is not None
    assert bench.gate.commander == b"second"
    assert bench.admit(payload(8), sender=b"first", sequence=99) is None  # it is another one now
    assert bench.rejected == {"other_commander": 2}


@pytest.mark.parametrize(("data", "reason"), REJECTIONS, ids=[reason for _, reason in REJECTIONS])
def test_only_a_valid_command_makes_a_commander(data, reason):
    bench = Bench()
    if reason != "stale":  # before the first command, no answer to a state is too old
        assert bench.admit(data, sender=b"stranger") is None
        assert bench.gate.commander is None
    assert bench.admit(payload(6), sender=b"controller") is not None
    assert bench.gate.commander == b"controller"


def test_repeated_number_is_refused_with_any_stamp():
    bench = Bench()
    bench.gate.await_answer(6)
    assert bench.admit(payload(5), sequence=3) is not None
    for sequence in (3, 2, 0, -1):
        assert bench.admit(payload(6), sequence=sequence) is None
    assert bench.rejected == {"replayed": 4}
    assert bench.gate.is_waiting  # a replay is no answer
    assert bench.admit(payload(6), sequence=4) is not None


def test_late_answer_uses_up_its_number():
    bench = Bench()
    bench.admit(payload(5), sequence=3)
    bench.admit(payload(4), sequence=8)
    assert bench.admit(payload(6), sequence=8) is None
    assert bench.rejected == {"stale": 1, "replayed": 1}


def test_sender_without_name_and_numbers_can_be_the_commander():
    bench = Bench()
    for stamp_ns in (5, 6, 7):
        assert bench.admit(payload(stamp_ns), sequence=0, sender=b"") is not None
    assert bench.admit(payload(8), sender=b"sender") is None
    assert bench.rejected == {"other_commander": 1}


def test_newest_state_itself_may_be_answered():
    assert Bench().admit(payload(NEWEST_NS)) is not None


@given(stamps=st.lists(st.integers(0, 2 * NEWEST_NS), max_size=30))
def test_admitted_stamps_only_ever_grow(stamps):
    bench = Bench()
    admitted = [command.stamp_ns for stamp in stamps if (command := bench.admit(payload(stamp)))]
    assert admitted == sorted(set(admitted))
    assert all(stamp <= NEWEST_NS for stamp in admitted)
    assert len(admitted) + bench.rejected.total() == len(stamps)


def test_target_comes_through_with_its_torque_and_is_kept_when_the_next_arrives():
    bench = Bench(takes_targets=True)
    first = bench.admit(aimed(5))
    assert first.torque_nm.tolist() == [1.0, 2.0, 3.0]
    assert first.target.tolist() == [[0.1, 0.2, 0.3], [-1.0, 0.0, 1.0]]
    bench.admit(aimed(6, position=(9.0, 9.0, 9.0)))
    assert first.target.tolist() == [[0.1, 0.2, 0.3], [-1.0, 0.0, 1.0]]
    assert not bench.rejected


@pytest.mark.parametrize("data", [payload(5), foreign(NAMES, (1.0, 2.0, 3.0))])
def test_command_of_torques_alone_has_no_target(data):
    bench = Bench(takes_targets=True)
    command = bench.admit(data)
    assert command.torque_nm.tolist() == [1.0, 2.0, 3.0]
    assert command.target is None
    assert not bench.rejected


@pytest.mark.parametrize(
    "data",
    [
        aimed(6, position=(0.1, np.nan, 0.3)), aimed(6, velocity=(0.0, np.inf, 0.0)),
        aimed(6, position=(np.nan,) * 3), aimed(6, velocity=(np.nan,) * 3),
        foreign(NAMES, (1.0, 2.0, 3.0), 6, position=(0.1, 0.2, 0.3)),
    ],
)  # fmt: skip
def test_target_that_is_not_all_numbers_is_rejected_with_its_torque(data):
    bench = Bench(takes_targets=True)
    assert bench.admit(aimed(5)) is not None
    assert bench.admit(data) is None
    assert bench.rejected == {"not_finite": 1}
    assert bench.gate.newest_ns == 5
    assert bench.admit(aimed(6)) is not None


def test_drives_that_take_torques_alone_are_given_no_target():
    bench = Bench()
    assert bench.admit(aimed(5, position=(np.nan,) * 3)).target is None
    assert not bench.rejected


@pytest.mark.parametrize(("data", "reason"), [*REJECTIONS, (payload(5, (9.0, 9.0, 9.0)), "stale")])
def test_rejected_command_in_the_commanders_name_bars_none_of_its_own(data, reason):
    bench = Bench()
    assert bench.admit(payload(5), sequence=1) is not None
    assert bench.admit(data, sequence=2**62) is None
    for index in range(700):
        assert bench.admit(payload(6 + index), sequence=2 + index) is not None
    assert bench.rejected == {reason: 1}


def test_two_senders_with_one_id_are_detected():
    forged = payload(7, (9.0, 9.0, 9.0))
    for number in (2, 3, 2**62):  # taken from the commander, ahead of it, far ahead of it
        bench = Bench()
        assert bench.admit(payload(5), sequence=1) is not None
        assert bench.admit(payload(6), sequence=2) is not None
        bench.admit(forged, sequence=number)
        bench.admit(payload(8), sequence=3)
        assert bench.gate.second_source is not None, number


def test_repeated_and_reordered_commands_are_no_second_sender():
    bench = Bench()
    for number in (1, 3, 2, 3, 900, 100, 2000, 2000):
        bench.admit(payload(100 + number), sequence=number)
    assert bench.gate.second_source is None
    assert bench.rejected == {"replayed": 4}


def test_successor_begins_with_its_own_numbers():
    bench = Bench()
    assert bench.admit(payload(5), sequence=2**40, sender=b"first") is not None
    bench.gone.add(b"first")
    assert bench.admit(payload(6), sequence=1, sender=b"second") is not None
    assert bench.admit(payload(7), sequence=2, sender=b"second") is not None
    assert bench.gate.second_source is None


def test_rows_for_the_following_ticks_come_in_the_order_of_the_plants_joints():
    bench = Bench(takes_targets=True)
    names = ("elbow", "yaw", "shoulder")
    numbers = np.arange(6.0)
    command = bench.admit(foreign(names, numbers, 5, numbers + 10.0, numbers + 20.0))
    assert command.torque_nm.tolist() == [1.0, 2.0, 0.0]
    assert command.target.tolist() == [[11.0, 12.0, 10.0], [21.0, 22.0, 20.0]]
    assert command.rows.torques_nm[1:].tolist() == [[4.0, 5.0, 3.0]]
    assert command.rows.targets[1:].tolist() == [[[14.0, 15.0, 13.0], [24.0, 25.0, 23.0]]]
    assert bench.admit(foreign(NAMES, (1.0, 2.0, 3.0), 6)).rows is None
    assert bench.admit(foreign(NAMES, numbers, 7, numbers[:3], numbers)) is None
    assert bench.rejected == {"wrong_size": 1}


def with_times(times: str, rows: int) -> bytes:
    """A command with rows and this frame_id, which says when it acts."""
    of_rows = layout(JOINT_COMMANDS, NAMES, has_acting_time=True, rows=rows)
    message = TYPESTORE.deserialize_cdr(of_rows.template, of_rows.type_name)
    message.header.frame_id = times
    message.header.stamp.nanosec = 5
    return bytes(TYPESTORE.serialize_cdr(message, of_rows.type_name))


@pytest.mark.parametrize(
    ("times", "acts_after_ns", "ticks"),
    [
        ("acts_after_ns=0048000000 row_ticks=50", 48_000_000, 50),
        ("acts_after_ns=7", 7, 1),
        ("base_link", 0, 1),
    ],
)
def test_a_command_says_when_it_acts_and_how_far_its_rows_are_apart(times, acts_after_ns, ticks):
    gate = CommandGate(NAMES, takes_acting_time=True)
    command = gate.admit(CommandArrival(with_times(times, 3), 1, b"sender", 0), NEWEST_NS)
    assert command.acts_after_ns == acts_after_ns
    assert command.rows.ticks == ticks


@pytest.mark.parametrize(
    "times",
    ["acts_after_ns=12345678901", "acts_after_ns=-5", "acts_after_ns=5 row_ticks=0",
     "acts_after_ns=5 row_ticks=10000", "acts_after_ns=5 row_ticks=2 "],
)  # fmt: skip
def test_a_command_with_other_times_does_not_act_at_once(times):
    gate = CommandGate(NAMES, takes_acting_time=True)
    arrival = CommandArrival(with_times(times, 3), 1, b"sender", 0)
    assert gate.admit(arrival, NEWEST_NS) is None
    assert gate.rejections.counts == {"malformed": 1}
