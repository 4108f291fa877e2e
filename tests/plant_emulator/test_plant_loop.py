"""When a plant in real time delivers states and applies commands."""

from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.link.interface import CommandArrival, CommandSessions, PlantLink
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.runtime.clock import VirtualClock
from deploy.scenario.scenario import load_setup
from plant_emulator.commands import Watchdog
from plant_emulator.plant_loop import PlantLoop
from tests.joint_states import joint_state

MS = 1_000_000
SUBSTEP_NS = 250_000
NAMES = ("base_yaw", "shoulder", "elbow")


class Station(PlantLink):
    """A link whose other end sends messages at set times."""

    def __init__(self, joint_names, clock):
        self.clock = clock
        self._layout = topics.layout(topics.JOINT_STATES, joint_names)
        self._command = Record(topics.layout(topics.JOINT_COMMANDS, joint_names))
        self.to_come = []
        self.delivered = []
        self.messages = []
        self.published = []
        self.stall_ns = {}  # by the stamp of the state whose delivery takes so long

    def expect(self, stamp_ns, arrival_ns):
        """A command answering the state of `stamp_ns` will arrive; torques tell which one it is."""
        self._command.stamp_ns = stamp_ns
        self._command.fields["effort"][:] = stamp_ns / MS
        arrival = CommandArrival(self._command.payload(), len(self.to_come) + 1, b"", arrival_ns)
        self.to_come.append(arrival)

    def publish(self, topic, payload):
        self.published.append((topic, payload))
        return 0

    def send_state(self, state, status):
        record = Record(self._layout)
        self._layout.decode(state, record)
        self.delivered.append((self.clock.now_ns(), record.stamp_ns))
        self.messages.append((state, status))
        self.clock.wait_until(self.clock.now_ns() + self.stall_ns.get(record.stamp_ns, 0))

    def take_commands(self):
        now_ns = self.clock.now_ns()
        here = [arrival for arrival in self.to_come if arrival.arrival_ns <= now_ns]
        self.to_come = [arrival for arrival in self.to_come if arrival.arrival_ns > now_ns]
        return here


@pytest.fixture
def run():
    """Runs a plant for 20 ms; the station, and (start of a substep, torque of joint 1) of each."""
    arms = []

    def start(*overrides, expected=(), arrivals=(), awake_ns=0, stall_ns=None):
        setup = load_setup("paper_arm", ["duration_s=0.02", *overrides])
        clock, arm = VirtualClock(), setup.arm()
        clock.awake_ns = awake_ns
        arms.append(arm)
        station = Station(setup.robot.joint_names, clock)
        station.stall_ns = stall_ns or {}
        for stamp_ns, arrival_ns in expected:
            station.expect(stamp_ns, arrival_ns)
        station.to_come += arrivals
        in_force, steps = [0.0], []
        command, advance = arm.command, arm.advance

        def note_command(torque_nm, target, stamp_ns):
            in_force[0] = float(torque_nm[0])
            command(torque_nm, target, stamp_ns)

        def note_advance(first, end):
            steps.extend((number * SUBSTEP_NS, in_force[0]) for number in range(first, end))
            advance(first, end)

        arm.command, arm.advance = note_command, note_advance
        loop = PlantLoop(setup.plant_task(lockstep=False), arm, station, clock)
        loop.run()
        station.late_ticks = loop.late_ticks
        return station, steps

    yield start
    for arm in arms:
        arm.close()


def test_states_are_delivered_when_they_fall_due_between_ticks(run):
    station, steps = run("link.uplink.delay_ms=2.4")
    assert station.delivered == [(k * MS + 2_400_000, k * MS) for k in range(18)]
    assert [start_ns for start_ns, _ in steps] == [k * SUBSTEP_NS for k in range(80)]


def test_states_that_overtake_each_other_are_delivered_each_at_its_time(run):
    station, _ = run("link.uplink={delay_ms: 4, jitter_ms: 3, reorder: true, duplicate: 0.3}")
    delays = np.array([now_ns - stamp_ns for now_ns, stamp_ns in station.delivered])
    assert np.all((delays >= 1 * MS) & (delays <= 7 * MS))
    assert np.any(delays % SUBSTEP_NS)
    stamps = [stamp_ns for _, stamp_ns in station.delivered]
    assert stamps != sorted(stamps)
    assert [now_ns for now_ns, _ in station.delivered] == sorted(t for t, _ in station.delivered)


@pytest.mark.parametrize("uplink_ms", [0, 2.97])
def test_waiting_awake_for_a_tick_changes_nothing(run, uplink_ms):
    """Nor do commands that arrive meanwhile come any later; the state tells which is in force."""
    first_ns = round(uplink_ms * MS) + 40_000
    expected = [(k * MS, k * MS + first_ns + k * 61_000) for k in range(1, 15)]
    asleep, steps_asleep = run(f"link.uplink.delay_ms={uplink_ms}", expected=expected)
    awake, steps = run(f"link.uplink.delay_ms={uplink_ms}", expected=expected, awake_ns=60_000)
    assert steps == steps_asleep
    assert len({torque for _, torque in steps}) > 10
    assert awake.delivered == asleep.delivered
    assert awake.messages == asleep.messages


def test_ticks_for_which_the_plant_comes_too_late_are_skipped_and_counted(run):
    """Nothing is measured there, but the physics goes through them."""
    in_time = "link.deadline_ms=100"  # of every command
    station, steps = run(in_time, stall_ns={5 * MS: 3_400_000})
    stamps = [stamp_ns // MS for _, stamp_ns in station.delivered]
    assert stamps == [0, 1, 2, 3, 4, 5, *range(8, 20)]
    assert [start_ns for start_ns, _ in steps] == [k * SUBSTEP_NS for k in range(80)]
    layout = topics.layout(topics.PLANT_TRUTH, ("base_yaw", "shoulder", "elbow"))
    truths = [payload for topic, payload in station.published if topic is topics.PLANT_TRUTH]
    assert layout.tabulate(truths)["timing.skipped"][[0, 5, -1]].tolist() == [0, 0, 2]
    assert station.late_ticks == 2
    assert run(in_time)[0].late_ticks == 0


def first_under(steps, torque_nm):
    return next(start_ns for start_ns, torque in steps if torque == torque_nm)


def test_command_is_in_force_from_the_substep_after_arrival_and_delay(run):
    _, steps = run("link.downlink.delay_ms=1", expected=[(3 * MS, 5_130_000)])
    assert first_under(steps, 3.0) == 6_250_000  # due at 6.13 ms


def test_command_that_comes_while_a_tick_is_under_way_is_not_late_for_its_last_substep(run):
    _, steps = run(expected=[(3 * MS, 4_600_000)])
    assert first_under(steps, 3.0) == 4_750_000


def test_rows_of_a_command_act_tick_by_tick_and_the_last_one_stays(run):
    """Rows of 1, 2 and 3 Nm answer the state of 4 ms; the command comes 1.3 ms late."""
    rows = joint_state(NAMES, effort=np.repeat([1.0, 2.0, 3.0], 3), stamp_ns=4 * MS)
    _, steps = run(arrivals=[CommandArrival(rows, 1, b"", 5_300_000)])
    torques_nm = dict(steps)
    assert [torques_nm[at] for at in (5 * MS, 5_250_000)] == [0.0, 0.0]
    assert [torques_nm[at] for at in (5_500_000, 5_750_000)] == [2.0, 2.0]  # the row for 5 ms
    assert {nm for at, nm in steps if at >= 6 * MS} == {3.0}


def test_rows_of_a_command_that_says_when_it_acts_count_from_then(run):
    """Rows of 1, 2, 3 and 4 Nm answer the state of 2 ms, and act from 5 ms on."""
    record = Record(topics.layout(topics.JOINT_COMMANDS, NAMES, has_acting_time=True, rows=4))
    record.fields["effort"][:] = np.repeat([1.0, 2.0, 3.0, 4.0], 3)
    record.stamp_ns, record.acts_after_ns = 2 * MS, 3 * MS
    for arrives_ns, first in ((2_600_000, 5), (6_100_000, 7)):  # in time, and too late for 5 ms
        arrivals = [CommandArrival(record.payload(), 1, b"", arrives_ns)]
        _, steps = run("controller.delay_compensation.enabled=true", arrivals=arrivals)
        torques_nm = dict(steps)
        assert {nm for at, nm in steps if at <= min(arrives_ns, 4_750_000)} == {0.0}
        assert [torques_nm[tick * MS] for tick in range(first, 12)] == [
            min(tick - 4, 4) for tick in range(first, 12)
        ]


def test_a_newer_command_ends_the_rows_of_the_one_before(run):
    rows = joint_state(NAMES, effort=np.repeat([1.0, 2.0, 3.0, 4.0], 3), stamp_ns=4 * MS)
    newer = joint_state(NAMES, effort=[9.0, 9.0, 9.0], stamp_ns=6 * MS)
    arrivals = [CommandArrival(rows, 1, b"", 4_100_000), CommandArrival(newer, 2, b"", 6_300_000)]
    _, steps = run(arrivals=arrivals)
    by_tick = [{nm for at, nm in steps if k * MS < at < (k + 1) * MS} for k in range(4, 9)]
    assert by_tick == [{1.0}, {2.0}, {3.0, 9.0}, {9.0}, {9.0}]


def test_command_waits_for_its_playout(run):
    arrivals = [(3 * MS, 4_100_000), (4 * MS, 4_200_000), (6 * MS, 12_010_000)]
    _, steps = run("link.playout_ms=5", "link.downlink.delay_ms=1", expected=arrivals)
    assert first_under(steps, 3.0) == 8 * MS
    assert first_under(steps, 4.0) == 9 * MS
    assert first_under(steps, 6.0) == 13_250_000  # too late for 11 ms: at once


def test_command_that_was_overtaken_changes_nothing(run):
    schedule = "[{kind: step, at_s: 0.0055, delay_ms: 1}]"
    _, steps = run(
        f"link.downlink={{delay_ms: 4, reorder: true, schedule: {schedule}}}",
        expected=[(3 * MS, 5 * MS), (4 * MS, 6 * MS)],
    )  # due at 9 ms and at 7 ms
    assert first_under(steps, 4.0) == 7 * MS
    assert 3.0 not in {torque for _, torque in steps}


def in_lockstep(setup, station, arm):
    """The outcome of a plant that waits for the answers of a station."""
    return PlantLoop(setup.plant_task(lockstep=True), arm, station, station.clock).run()


class LeavingController(Station):
    """Its one answer arrives, and it leaves, just when the plant has waited in vain."""

    waits = 0

    def take_commands(self):
        return super().take_commands() if self.waits > 1 else []

    def await_command(self, timeout_s):
        self.waits += 1
        return self.waits > 1 and bool(self.to_come)

    def controller_has_left(self):
        return True


def test_answer_that_came_just_before_the_controller_left_is_taken():
    setup = load_setup("paper_arm", ["duration_s=0.02"])
    station = LeavingController(setup.robot.joint_names, VirtualClock())
    station.expect(0, 0)
    taken = []
    with closing(setup.arm()) as arm:
        command = arm.command
        arm.command = lambda *given: taken.append(given) or command(*given)
        outcome = in_lockstep(setup, station, arm)
    assert len(taken) == 1
    assert outcome.faults == ["the controller has left the bus"]


class DeafController(Station, CommandSessions):
    """A stranger that hears nothing before the third state, and answers from there on."""

    @property
    def sessions(self):
        return self

    def may_miss_states(self):
        return True

    def await_command(self, timeout_s):
        return bool(self.to_come)

    def controller_has_left(self):
        return False

    def send_state(self, state, status):
        super().send_state(state, status)
        if len(self.delivered) >= 3:
            now_ns, stamp_ns = self.delivered[-1]
            self.expect(stamp_ns, now_ns)
            self.to_come[-1] = self.to_come[-1]._replace(sequence=len(self.delivered))


def test_first_state_in_lockstep_is_sent_again_until_it_is_answered():
    setup = load_setup("paper_arm", ["duration_s=0.005"])
    station = DeafController(setup.robot.joint_names, VirtualClock())
    with closing(setup.arm()) as arm:
        outcome = in_lockstep(setup, station, arm)
    assert outcome.faults == []
    assert [stamp_ns // MS for _, stamp_ns in station.delivered] == [0, 0, 0, 1, 2, 3, 4]


@given(
    first_ns=st.integers(1, 1000), timeout_ns=st.integers(1, 1000),
    gaps=st.lists(st.integers(0, 1000), min_size=1),
)  # fmt: skip
def test_expires_after_the_first_instant_and_then_after_longer_silence_than_the_timeout(
    first_ns, timeout_ns, gaps
):
    watchdog, now_ns, allowed_ns = Watchdog(timeout_ns, first_ns), 0, first_ns
    for gap in gaps:
        now_ns += gap
        assert (watchdog.expires_ns < now_ns) == (gap > allowed_ns)
        watchdog.feed(now_ns)
        allowed_ns = timeout_ns
