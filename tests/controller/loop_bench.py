"""A control loop on an in-process bus, and states to feed it."""

import numpy as np

from bus_schema.limits import JointLimits
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink, InProcessPlantLink
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.runtime.clock import VirtualClock
from controller.configuration import ControllerConfiguration
from controller.control_law import Diagnostics
from controller.control_loop import ControlLoop, ControlTask
from controller.funnel import FunnelConfiguration
from controller.manipulator_model import ManipulatorModel
from controller.reference import JointSinusoids
from tests.arms import PAPER_ARM
from tests.controller.compensation.prediction_bench import compensation_of

ROBOT = PAPER_ARM
NAMES = ROBOT.joint_names
INERTIA = ManipulatorModel(ROBOT).governing_inertia(np.zeros((1, 3)))
OFFSET = np.array([0.15, -0.12, 0.10])
SWING = JointSinusoids(np.array([0.1, -0.5, 0.8]), np.array([[[0.1, 2.0, 0.3]] * 3]))
MS = 1_000_000


class Bench:
    """A control loop on an in-process bus, with a plant that says what the test says."""

    def __init__(
        self, law="pid", reference=SWING, rate_limit=np.inf, own_law=None, compensation=None,
        *, sends_targets=False, longest_step_s=np.inf,
    ):  # fmt: skip
        configuration = ControllerConfiguration(law=law)
        gains = configuration.build_gains(ROBOT, INERTIA)
        self.funnel = FunnelConfiguration().build(OFFSET)
        self.reference = reference
        limits = JointLimits.of_torques(ROBOT.effort_limits_nm, np.full(3, rate_limit))
        self.law = own_law or configuration.build_law(gains, ROBOT)
        task = ControlTask(
            ROBOT,
            reference,
            self.funnel,
            self.law,
            law,
            limits,
            compensation,
            sends_targets,
            longest_step_s,
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
            record.memory[:] = arrival.payload
            if "position" in record.fields:
                rows = record.fields["position"], record.fields["velocity"]
                self.targets.append(np.array(rows))
            answers.append((record.stamp_ns, record.fields["effort"].tolist(), arrival.sequence))
        return answers

    @property
    def received(self):
        """Topic and payload of all messages so far."""
        return list(zip(self.bus.topics, self.bus.payloads, strict=True))

    def last(self, topic):
        """The newest message on a topic."""
        record = Record(topics.layout(topic, NAMES))
        record.memory[:] = next(
            payload for name, payload in reversed(self.received) if name is topic
        )
        return record


def predicting(first_horizon_ns=20 * MS):
    return compensation_of(model=True, friction=True, first_ns=first_horizon_ns)


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


class Spectator(KeepsItsDiagnostics):
    """A law that remembers its inputs, and fails on request."""

    def __init__(self):
        super().__init__()
        self.shown, self.times_s, self.steps_s, self.fails = [], [], [], False

    def torque(self, tracking):
        self.shown.append(tracking)
        self.times_s.append(tracking.time_s)
        self.steps_s.append(tracking.step_s)
        return np.full(3, np.nan) if self.fails else super().torque(tracking)

    def reset(self):
        pass
