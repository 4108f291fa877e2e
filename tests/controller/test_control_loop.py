from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schema.drive_feedback import no_drive_feedback
from bus_schema.limits import JointLimits
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.messages import topics
from bus_schema.messages.layout import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import RUN_EVENTS
from bus_schema.messages.types import JOINT_STATE, PLANT_STATUS, TYPESTORE
from bus_schema.robot_description import load_robot
from bus_schema.runtime.clock import VirtualClock
from bus_schema.runtime.modes import Mode, mode_in
from controller.compensation.arm_belief import nominal_arm
from controller.compensation.delay_compensation import DelayCompensation
from controller.compensation.model_identification import identification
from controller.configuration import ControllerConfiguration
from controller.control_law import Diagnostics
from controller.control_loop import ControlLoop, ControlTask
from controller.funnel_configuration import FunnelConfiguration
from controller.manipulator_model import ManipulatorModel
from controller.reference import CartesianPath, JointSinusoids
from controller.torque_guard import InvalidTorqueError
from deploy.scenario.referenced_files import find_urdf

ROBOT = load_robot(find_urdf("paper_arm", Path()))
NAMES = ROBOT.joint_names
INERTIA = ManipulatorModel(ROBOT).governing_inertia(np.zeros((1, 3)))
OFFSET = np.array([0.15, -0.12, 0.10])
SWING = JointSinusoids(np.array([0.1, -0.5, 0.8]), np.array([[[0.1, 2.0, 0.3]] * 3]))
MS = 1_000_000


class Bench:
    """A control loop on an in-process bus, with a plant that says what the test says."""

    def __init__(
        self, law="pid", reference=SWING, rate_limit=np.inf, own_law=None, compensation=None,
        *, sends_targets=False,
    ):  # fmt: skip
        configuration = ControllerConfiguration(law=law)
        gains = configuration.build_gains(ROBOT, INERTIA)
        self.funnel = FunnelConfiguration().build(OFFSET)
        self.reference = reference
        limits = JointLimits.of_torques(ROBOT.effort_limits_nm, np.full(3, rate_limit))
        self.law = own_law or configuration.build_law(gains, ROBOT)
        task = ControlTask(
            ROBOT, reference, self.funnel, self.law, law, limits, compensation, sends_targets
        )
        self.compensation = compensation
        self.command_layout = topics.layout(topics.JOINT_COMMANDS, NAMES, has_targets=sends_targets)
        self.bus = InProcessBus(VirtualClock())
        self.plant = InProcessPlantLink(self.bus)
        self.loop = ControlLoop(task, InProcessControllerLink(self.bus))

    def send(self, stamp_ns, error=OFFSET, start_ns=0):
        """Send a state with this error at its stamp; the answers as (stamp, torque, sequence)."""
        at = self.at(stamp_ns - start_ns)
        self.plant.send_state(state(stamp_ns, at + error), status(stamp_ns, start_ns))
        return self.answers()

    def at(self, time_ns):
        rows = np.empty((3, 3))
        self.reference.evaluate(time_ns * 1e-9, *rows)
        return rows[0]

    def answers(self):
        record, answers, self.targets = Record(self.command_layout), [], []
        for arrival in self.plant.take_commands():
            record.load(arrival.payload)
            if "position" in record.fields:
                rows = record.fields["position"], record.fields["velocity"]
                self.targets.append(np.array(rows))
            answers.append((record.stamp_ns, record.fields["effort"].tolist(), arrival.sequence))
        return answers

    @property
    def heard(self):
        """Topic and payload of all messages so far."""
        return list(zip(self.bus.topics, self.bus.payloads, strict=True))

    def last(self, topic):
        """The newest message on a topic."""
        record = Record(topics.layout(topic, NAMES))
        record.load(next(payload for name, payload in reversed(self.heard) if name is topic))
        return record


def predicting(first_horizon_ns=20 * MS):
    loaded = ManipulatorModel(ROBOT, payload_kg=1.0)
    return DelayCompensation(
        nominal_arm(ManipulatorModel(ROBOT), loaded, ROBOT.effort_limits_nm),
        identification(INERTIA, model=True, friction=True),
        no_drive_feedback(3),
        observer_bandwidth_rad_s=60.0, least_horizon_ns=0, first_horizon_ns=first_horizon_ns,
    )  # fmt: skip


def state(stamp_ns, position, velocity=(0.0, 0.0, 0.0)):
    record = Record(topics.layout(topics.JOINT_STATES, NAMES))
    record.stamp_ns = stamp_ns
    record.fields["position"][:] = position
    record.fields["velocity"][:] = velocity
    return record.payload()


def status(stamp_ns, start_ns=0):
    record = Record(topics.layout(topics.PLANT_STATUS, NAMES))
    record.stamp_ns = stamp_ns
    start = divmod(start_ns, 1_000_000_000)
    record.fields["start.sec"][0], record.fields["start.nanosec"][0] = start
    return record.payload()


def test_first_state_is_answered_at_its_own_stamp_with_a_torque_against_the_error():
    bench = Bench()
    ((stamp_ns, torque, sequence),) = bench.send(5 * MS)
    assert stamp_ns == 5 * MS
    assert sequence == 1
    assert (np.array(torque) * OFFSET < 0.0).all()
    assert (bench.loop.cycles, bench.loop.late) == (1, 0)


def test_first_state_integrates_nothing():
    # No step has passed: PID at the first state is −K_p e − K_d ė alone.
    bench = Bench()
    ((_, torque, _),) = bench.send(700 * MS)
    gains = bench.law.gains
    rows = np.empty((3, 3))
    SWING.evaluate(0.7, *rows)
    expected = -(gains.proportional * OFFSET + gains.derivative * (0.0 - rows[1]))
    limits = ROBOT.effort_limits_nm
    np.testing.assert_allclose(torque, np.clip(expected, -limits, limits), rtol=1e-12)


@settings(max_examples=25)
@given(stamps=st.lists(st.integers(0, 10**12), min_size=1, max_size=20))
def test_every_answer_echoes_the_stamp_of_its_state(stamps):
    bench = Bench()
    assert [answer[0] for stamp in stamps for answer in bench.send(stamp)] == stamps
    assert bench.loop.cycles + bench.loop.late == len(stamps)


@pytest.mark.parametrize("stamp_ns", [9 * MS, 10 * MS, 0])
def test_late_and_duplicate_states_get_the_torque_in_force(stamp_ns):
    bench = Bench("fixed_time_neural")
    bench.send(9 * MS)
    ((_, in_force, _),) = bench.send(10 * MS, 0.9 * OFFSET)
    ((echoed_ns, torque, sequence),) = bench.send(stamp_ns, -OFFSET)
    assert echoed_ns == stamp_ns
    assert torque == in_force
    assert sequence == 3
    assert (bench.loop.cycles, bench.loop.late) == (2, 1)


@pytest.mark.parametrize("law", ["pid", "fixed_time_neural"])
def test_late_states_change_nothing_in_the_law(law):
    disturbed, quiet = Bench(law), Bench(law)
    for bench in (disturbed, quiet):
        bench.send(1 * MS)
        bench.send(3 * MS, 0.9 * OFFSET)
    disturbed.send(2 * MS, -OFFSET)
    disturbed.send(3 * MS, -OFFSET)
    after = [bench.send(4 * MS, 0.8 * OFFSET)[0][1] for bench in (disturbed, quiet)]
    assert after[0] == after[1]


@pytest.mark.parametrize("law", ["pid", "fixed_time_neural"])
def test_warming_up_leaves_no_trace(law):
    warm, cold = Bench(law, rate_limit=1000.0), Bench(law, rate_limit=1000.0)
    warm.loop.warm_up()
    assert warm.heard == []
    for tick in range(5):
        assert warm.send(tick * MS, 0.1 * OFFSET) == cold.send(tick * MS, 0.1 * OFFSET)


def test_unusable_states_are_ignored_and_counted():
    bench, silent = Bench(), []
    bench.send(0)
    names = ("base_yaw", "shoulder", "wrist")
    stranger = Record(topics.layout(topics.JOINT_STATES, names)).payload()
    for payload in (
        b"", b"garbage", stranger,
        state(MS, (np.nan, 0.0, 0.0)), state(MS, (0.0, 0.0, 0.0), (0.0, np.inf, 0.0)),
    ):  # fmt: skip
        bench.plant.send_state(payload, status(MS))
        silent += bench.answers()
    assert silent == []
    assert bench.loop.rejections.counts == {"malformed": 2, "wrong_names": 1, "not_finite": 2}
    assert bench.loop.cycles == 1
    assert len(bench.send(MS)) == 1  # none of their stamps counted


def test_foreign_state_without_velocities_is_not_finite():
    types = TYPESTORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 1), "world")
    message = types[JOINT_STATE](header, list(NAMES), np.zeros(3), np.zeros(0), np.zeros(0))
    bench = Bench()
    bench.loop.cycle(bytes(TYPESTORE.serialize_cdr(message, JOINT_STATE)), None)
    assert bench.answers() == []
    assert bench.loop.rejections.counts == {"not_finite": 1}


@settings(max_examples=100)
@given(
    payload=st.binary(max_size=200),
    flips=st.lists(st.integers(0, 10_000), min_size=1, max_size=6),
    plant_status=st.one_of(st.none(), st.binary(max_size=60), st.just(status(0))),
)
def test_no_bytes_stop_the_loop(payload, flips, plant_status):
    bench = Bench()
    flipped = bytearray(state(0, bench.at(0) + OFFSET))
    for flip in flips:  # in stamp, names and counts; a flipped position is another position
        flipped[flip // 8 % (len(flipped) - 3 * 32)] ^= 1 << flip % 8
    for bytes_seen in (payload, bytes(flipped)):
        bench.loop.cycle(bytes_seen, plant_status)
    answered = bench.loop.cycles + bench.loop.late
    assert len(bench.answers()) == answered


@pytest.mark.parametrize(("sec", "nanosec"), [(2**31 - 1, 2**32 - 1), (0, 10**9)])
def test_stamp_with_more_than_a_second_of_nanoseconds_is_malformed(sec, nanosec):
    record = Record(topics.layout(topics.JOINT_STATES, NAMES))
    record.fields["header.stamp.sec"][0] = sec
    record.fields["header.stamp.nanosec"][0] = nanosec
    bench = Bench()
    bench.plant.send_state(record.payload(), status(0))
    assert bench.answers() == []
    assert bench.loop.rejections.counts.total() == 1


def test_time_starts_where_the_plant_says_it_does():
    bench = Bench()
    start_ns = 3_000_000_500
    bench.send(start_ns + 100 * MS, start_ns=start_ns)
    expected = bench.at(100 * MS)
    np.testing.assert_array_equal(
        bench.last(topics.CONTROL_STATUS).fields["reference_position"], expected
    )


def test_foreign_plant_without_status_starts_time_at_its_first_stamp():
    bench, first_ns = Bench(), 86_400 * 1_000_000_000
    for elapsed_ns in (0, MS, 250 * MS):
        bench.loop.cycle(state(first_ns + elapsed_ns, bench.at(elapsed_ns) + OFFSET), None)
        ((stamp_ns, torque, _),) = bench.answers()
        assert stamp_ns == first_ns + elapsed_ns
        assert np.isfinite(torque).all()
        fields = bench.last(topics.CONTROL_STATUS).fields
        np.testing.assert_array_equal(fields["reference_position"], bench.at(elapsed_ns))
        np.testing.assert_allclose(fields["error"], OFFSET, atol=1e-15)


def foreign_status(start_sec):
    types = TYPESTORE.types
    time = types["builtin_interfaces/msg/Time"]
    header = types["std_msgs/msg/Header"](time(0, 0), "world")
    message = types[PLANT_STATUS](header, time(start_sec, 0), 0, 0, -1, -1)
    return bytes(TYPESTORE.serialize_cdr(message, PLANT_STATUS))


def test_plant_status_of_a_foreign_encoder_is_understood():
    bench = Bench()
    bench.loop.cycle(state(7_100 * MS, bench.at(100 * MS)), foreign_status(start_sec=7))
    fields = bench.last(topics.CONTROL_STATUS).fields
    np.testing.assert_array_equal(fields["reference_position"], bench.at(100 * MS))


def test_garbage_status_is_counted_and_the_state_answered():
    bench = Bench()
    bench.loop.cycle(state(7 * MS, bench.at(0)), b"garbage")
    assert len(bench.answers()) == 1
    assert bench.loop.rejections.counts == {"malformed": 1}
    fields = bench.last(topics.CONTROL_STATUS).fields
    np.testing.assert_array_equal(fields["reference_position"], bench.at(0))


def test_control_status_tells_what_the_law_thought():
    bench = Bench("fixed_time_neural")
    bench.send(0)
    ((_, _, sequence),) = bench.send(100 * MS, 0.5 * OFFSET)
    record = bench.last(topics.CONTROL_STATUS)
    fields = record.fields
    rows = np.empty((3, 3))
    SWING.evaluate(0.1, *rows)
    upper, lower = bench.funnel.bounds(np.array([0.1]))
    assert record.stamp_ns == 100 * MS
    assert fields["sequence"][0] == sequence == 2
    np.testing.assert_array_equal(fields["reference_position"], rows[0])
    np.testing.assert_array_equal(fields["reference_velocity"], rows[1])
    np.testing.assert_allclose(fields["error"], 0.5 * OFFSET, atol=1e-15)
    np.testing.assert_array_equal(fields["error_rate"], -rows[1])
    np.testing.assert_allclose(fields["upper_bound"], upper[0], rtol=1e-14)
    np.testing.assert_allclose(fields["lower_bound"], lower[0], rtol=1e-14)
    error, above, below = fields["error"], fields["upper_bound"], -fields["lower_bound"]
    expected = 0.5 * np.log((1 + error / below) / (1 - error / above))
    np.testing.assert_allclose(fields["transformed_error"], expected, rtol=1e-12)
    for name in ("sliding_variable", "network_output", "network_norm"):
        assert np.isfinite(fields[name]).all()
        assert fields[name].any()  # a joint whose torque was saturated has learned nothing yet


def test_what_a_law_has_not_is_nan():
    bench = Bench("pid")
    bench.send(0)
    fields = bench.last(topics.CONTROL_STATUS).fields
    for name in ("transformed_error", "sliding_variable", "network_output", "network_norm"):
        assert np.isnan(fields[name]).all()


def test_each_cycle_sends_command_then_status_with_its_timing():
    bench = Bench()
    for tick in range(3):
        bench.send(tick * MS)
    bench.send(0)  # late: a command alone
    sent = [topic.name for topic, _ in bench.heard if topic.sender == "controller"]
    cycle = ["joint_commands", "control_status"]
    assert sent == [*cycle * 3, "joint_commands"]
    timing = bench.last(topics.CONTROL_STATUS)
    assert timing.stamp_ns == 2 * MS
    assert timing.fields["timing.cycle"][0] == 2
    assert timing.fields["timing.step_ns"][0] > 0


def test_sent_torques_are_limited():
    bench = Bench()
    ((_, torque, _),) = bench.send(0, error=np.array([100.0, -100.0, 100.0]))
    assert torque == [-400.0, 700.0, -300.0]


def test_rate_limit_uses_the_time_between_stamps():
    bench = Bench(rate_limit=1000.0)
    ((_, first, _),) = bench.send(0)
    ((_, second, _),) = bench.send(20 * MS, -OFFSET)
    # 1000 N m/s over 20 ms.
    np.testing.assert_allclose(np.abs(np.subtract(second, first)), 20.0, rtol=1e-12)


def test_law_that_returns_nan_is_told_by_name_and_cycle():
    leaving = np.array([[0.9, 1.0, 0, 0, 0], [0.1, 0, 0, 0, 0], [0.5, 0, 0, 0, 0]])
    bench = Bench("pid", CartesianPath(leaving, 0.25, 0.70, 0.60))
    bench.send(0)
    bench.plant.send_state(state(1000 * MS, np.zeros(3)), status(0))
    failure = bench.bus.failure
    assert isinstance(failure, InvalidTorqueError)
    assert "law pid" in str(failure)
    assert failure.tick == 1
    ((stamp_ns, torque, _),) = bench.answers()  # the torque of stopping, and nothing after it
    assert (stamp_ns, torque) == (1000 * MS, [0.0, 0.0, 0.0])
    bench.loop.cycle(state(1001 * MS, np.zeros(3)), status(0))
    assert bench.answers() == []
    assert bench.loop.mode is Mode.FAULT
    told = [RunEvent.decode(payload) for topic, payload in bench.heard if topic is RUN_EVENTS]
    assert [mode_in(event.detail) for event in told if event.kind == EventKind.MODE] == [
        Mode.READY, Mode.TRACKING, Mode.STOPPING, Mode.FAULT,
    ]  # fmt: skip
    assert [event.detail for event in told if event.kind == EventKind.FAULT] == [str(failure)]


class KeepsItsDiagnostics:
    """A law that keeps hold of an array of its diagnostics, and assigns to another."""

    def __init__(self):
        self.diagnostics = Diagnostics(3)
        self._transformed_error = self.diagnostics.transformed_error

    def torque(self, tracking):
        self._transformed_error[:] = (1.0, 2.0, 3.0)
        self.diagnostics.sliding_variable = 2.0 * tracking.error
        self.diagnostics.network_norm = 7.0
        return np.zeros(3)

    def reset(self):
        self.__init__()  # new diagnostics


def test_diagnostics_are_published_whether_a_law_writes_into_them_or_assigns_them():
    bench = Bench(own_law=KeepsItsDiagnostics())
    bench.loop.warm_up()
    bench.send(5 * MS)
    status = bench.last(topics.CONTROL_STATUS)
    assert status.fields["transformed_error"].tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(status.fields["sliding_variable"], 2.0 * OFFSET, rtol=1e-12)
    assert np.isnan(status.fields["network_output"]).all()
    assert status.scalars.network_norm == 7.0


class Spectator(KeepsItsDiagnostics):
    """A law that remembers what it was shown, and fails when it is told to."""

    def __init__(self):
        super().__init__()
        self.shown, self.times_s, self.fails = [], [], False

    def torque(self, tracking):
        self.shown.append(tracking)
        self.times_s.append(tracking.time_s)
        return np.full(3, np.nan) if self.fails else super().torque(tracking)

    def reset(self):
        pass


@pytest.mark.parametrize("is_compensated", [False, True])
def test_warming_up_shows_a_law_the_very_situation_it_will_be_shown(is_compensated):
    """A law binds its kernels to it: another one would be bound while time counts."""
    compensation = predicting() if is_compensated else None
    bench = Bench(own_law=Spectator(), compensation=compensation)
    bench.loop.warm_up()
    bench.send(0)
    bench.send(MS)
    shown = compensation.predicted if is_compensated else bench.loop.tracking
    assert [each is shown for each in bench.law.shown] == [True] * 3


@pytest.mark.parametrize("law", ["pid", "fixed_time_neural", "ftsmc"])
def test_warming_up_leaves_no_trace_in_a_compensation(law):
    warm, cold = (Bench(law, compensation=predicting(), sends_targets=True) for _ in range(2))
    warm.loop.warm_up()
    assert warm.heard == []
    for tick in range(5):
        assert warm.send(tick * MS, 0.1 * OFFSET) == cold.send(tick * MS, 0.1 * OFFSET)
        np.testing.assert_array_equal(warm.targets, cold.targets)


def test_a_compensated_law_sees_the_time_at_which_its_torque_is_expected_to_act():
    bench = Bench(own_law=Spectator(), compensation=predicting(20 * MS))
    for tick in range(31):
        bench.send(tick * MS)
    # Nothing acts, as the plant says: after 20 ms, as long as was waited.
    assert bench.law.times_s[0] == pytest.approx(0.020)
    assert bench.law.times_s[20] == pytest.approx(0.040)
    assert bench.law.times_s[30] == pytest.approx(0.060)


def test_targets_without_foresight_are_the_reference():
    bench = Bench(sends_targets=True)
    bench.send(100 * MS, start_ns=0)
    rows = np.empty((3, 3))
    SWING.evaluate(0.1, *rows)
    np.testing.assert_array_equal(bench.targets, [rows[:2]])


def test_targets_with_foresight_lead_to_the_state_foreseen():
    bench = Bench(compensation=predicting(20 * MS), sends_targets=True)
    bench.send(0)
    ((position, velocity),) = bench.targets
    seen = bench.compensation.predicted
    np.testing.assert_allclose(position + 0.020 * velocity, seen.position, rtol=1e-14)
    np.testing.assert_array_equal(velocity, seen.velocity)


def test_commands_without_targets_have_none():
    bench = Bench(compensation=predicting())
    bench.send(0)
    assert bench.targets == []
    payload = next(payload for topic, payload in bench.heard if topic is topics.JOINT_COMMANDS)
    types = TYPESTORE.types
    message = TYPESTORE.deserialize_cdr(payload, JOINT_STATE)
    assert (message.position.size, message.velocity.size, message.effort.size) == (0, 0, 3)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    same = types[JOINT_STATE](header, list(NAMES), np.zeros(0), np.zeros(0), message.effort)
    assert payload == bytes(TYPESTORE.serialize_cdr(same, JOINT_STATE))


def test_a_controller_that_stops_sends_no_target():
    bench = Bench(own_law=Spectator(), compensation=predicting(), sends_targets=True)
    bench.send(0)
    assert np.isfinite(bench.targets).all()
    bench.law.fails = True
    bench.plant.send_state(state(MS, bench.at(MS)), status(MS))
    ((stamp_ns, torque, _),) = bench.answers()
    assert (stamp_ns, torque) == (MS, [0.0, 0.0, 0.0])
    assert np.isnan(bench.targets).all()
