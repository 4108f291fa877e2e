"""Delay compensation: a wrapper that shows a control law the future it will act in.

A torque sent now acts one horizon after the state it answers was measured: the round trip of the
bus, or the plant's play-out time if that is longer. So the law is given not the measured state but
the one that the arm will be in by then, with reference and funnel of that time. Any law can be
wrapped, as it sees nothing but another `Tracking`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.drive_feedback import DriveGains
from bus_schema.runtime.compiled import bind, compiled
from bus_schema.runtime.finite import all_finite
from controller.compensation.arm_belief import ArmBelief, NominalArm, first_belief, forget
from controller.compensation.command_timeline import (
    HELD,
    LONGEST_HORIZON_NS,
    CommandFeedback,
    Commands,
    CommandTimeline,
    Flight,
)
from controller.compensation.disturbance_observer import observe
from controller.compensation.model_identification import Identification, start_again, take_in
from controller.compensation.motion_predictor import move
from controller.control_law import LOWER, UPPER, Tracking
from controller.funnel import Funnel
from controller.reference import Reference
from controller.rigid_bodies.dynamics import mass_and_load


class Arm(NamedTuple):
    """All that a prediction works with, for compiled code.

    Attributes:
        nominal: the arm as the controller was told.
        belief: what it believes by now.
        identification: how it learns that.
        drive: what the drives add of their own.
        commands: all that were sent.
    """

    nominal: NominalArm
    belief: ArmBelief
    identification: Identification
    drive: DriveGains
    commands: Commands


class DelayCompensation:
    """Predicts the state in which a command will act.

    Args:
        nominal: the nominal arm.
        identification: what is to be learned of its model; as fresh.
        drive: what the drives add of their own.
        observer_bandwidth_rad_s: how fast disturbances are learned.
        least_horizon_ns: no torque acts sooner than this after the state it answers.
        first_horizon_ns: what the horizon is taken for until a command has come into force.

    Attributes:
        timeline: the commands sent, and the horizon.
        belief: what is believed of the arm.
        identification: how the model was learned.
        predicted: the situation predicted last.
        target: that state as a target for the drives, as of the stamp of the state that was
            answered: position, rad, and velocity, rad/s, as rows; shape (2, joints).
    """

    def __init__(
        self,
        nominal: NominalArm,
        identification: Identification,
        drive: DriveGains,
        *,
        observer_bandwidth_rad_s: float,
        least_horizon_ns: int,
        first_horizon_ns: int,
    ) -> None:
        joints = nominal.limits_nm.size
        self.timeline = CommandTimeline(joints, least_horizon_ns, first_horizon_ns)
        self.belief = first_belief(nominal)
        self.identification = identification
        self.predicted = Tracking(joints)
        self.target: Matrix = np.zeros((2, joints))
        self._bandwidth_rad_s = observer_bandwidth_rad_s
        self._arm = Arm(nominal, self.belief, identification, drive, self.timeline.commands)
        self._measured: Tracking | None = None
        self._last: Matrix = np.zeros((2, joints))
        self.reset()

    def reset(self) -> None:
        """Forget all commands and all that was learned."""
        self.timeline.reset()
        forget(self._arm.nominal, self.belief)
        start_again(self.identification)
        self._last_in_force, self._last_ns = HELD, 0

    def warm_up(self, measured: Tracking, reference: Reference, funnel: Funnel) -> None:
        """Compile everything before time counts, and leave no trace of it."""
        self.note_command(1, 0, measured.velocity)
        for stamp_ns in (1_000_000, 2_000_000):
            self.predict(measured, stamp_ns, CommandFeedback(1, stamp_ns), reference, funnel)
        self.reset()

    def note_command(self, number: int, stamp_ns: int, torque_nm: Vector) -> None:
        """A command was sent in answer to the state of `stamp_ns`; numbers increase."""
        self.timeline.note(number, stamp_ns, torque_nm, self.target)

    def predict(
        self,
        measured: Tracking,
        stamp_ns: int,
        feedback: CommandFeedback | None,
        reference: Reference,
        funnel: Funnel,
    ) -> Tracking:
        """The situation in which the answer to a state will act.

        Args:
            measured: the situation at the state; states come in order.
            stamp_ns: stamp of the state.
            feedback: the command in force at it; None if the plant does not say.
            reference: the reference of `measured`.
            funnel: the funnel of `measured`.
        """
        if measured is not self._measured:
            self._bind(measured)
        timeline = self.timeline
        if feedback is not None and timeline.explains(feedback, stamp_ns):
            timeline.observe(feedback, stamp_ns)
        else:
            feedback = CommandFeedback(timeline.assumed_in_force(stamp_ns), timeline.horizon_ns)
        is_moving = HELD < self._last_in_force <= feedback.sequence
        if is_moving and stamp_ns - self._last_ns <= LONGEST_HORIZON_NS:
            acted = timeline.between(self._last_in_force, feedback, self._last_ns)
            gain = 1.0 - math.exp(-self._bandwidth_rad_s * 1e-9 * (stamp_ns - self._last_ns))
            self._learn(*acted, self._last_ns, stamp_ns, gain)
        self._last_in_force, self._last_ns = feedback.sequence, stamp_ns
        ahead = timeline.ahead(feedback.sequence, stamp_ns)
        horizon_s = self._predict(*ahead, stamp_ns, stamp_ns + timeline.horizon_ns)
        self.predicted.horizon_s = horizon_s
        time_s = measured.time_s + horizon_s
        self.predicted.update(time_s, measured.step_s, reference, funnel)
        return self.predicted

    def _bind(self, measured: Tracking) -> None:
        """Fix what compiled code works on: to find out its types costs more than its work."""
        self._measured = measured
        six = ["int64"] * 6
        self._learn = bind(
            _learn, self._arm, measured.motion, measured.error, measured.bounds, self._last,
            free=[*six, "float64"],
        )  # fmt: skip
        self._predict = bind(
            _predict, self._arm, measured.motion, self._last, self.predicted.motion, self.target,
            free=six,
        )  # fmt: skip


@compiled
def _learn(
    arm: Arm, measured: Matrix, error: Vector, bounds: Matrix, last: Matrix,
    in_force: int, upcoming: int, newest: int, delay_ns: int, last_ns: int, stamp_ns: int,
    gain: float,
) -> None:  # fmt: skip
    """Compare how the arm moved since the last state with how it should have moved."""
    nominal, belief, identification, drive, commands = arm
    joints, step_s = error.size, (stamp_ns - last_ns) * 1e-9
    motion, impulse = np.empty((3, joints)), np.empty(joints)
    actuator, actuator_before = belief.actuator_nm.copy(), belief.actuator_nm.copy()
    motion[:2] = last
    flight = Flight(in_force, upcoming, newest, delay_ns)
    move(nominal, belief, drive, commands, flight, last_ns, stamp_ns, motion, actuator, impulse)
    mass, load = np.empty((joints, joints)), np.empty(joints)
    mass_and_load(nominal.bodies, belief.inertia, measured[0], measured[1], mass, load)
    if not all_finite(actuator):
        return
    belief.actuator_nm[:] = actuator
    if not observe(mass, measured[1], motion[1], step_s, gain, belief.disturbance_nm):
        return
    if identification.is_active and _is_inside(error, bounds):
        take_in(nominal, identification, belief, last, measured, actuator_before, impulse, step_s)
    else:
        identification.window.elapsed_s[0] = 0.0


@compiled
def _is_inside(error: Vector, bounds: Matrix) -> bool:
    """Whether all errors are inside the funnel; what is learned in a lost arm's motion is wild."""
    for i in range(error.size):  # noqa: SIM110 (numba compiles no generators)
        if not -bounds[LOWER, i] < error[i] < bounds[UPPER, i]:
            return False
    return True


@compiled
def _predict(
    arm: Arm, measured: Matrix, last: Matrix, predicted: Matrix, target: Matrix,
    in_force: int, upcoming: int, newest: int, delay_ns: int, stamp_ns: int, until_ns: int,
) -> float:  # fmt: skip
    """The state in which a torque will act into `predicted`, shape (2, joints); how far ahead."""
    nominal, belief, _, drive, commands = arm
    joints = measured.shape[1]
    motion, impulse = np.empty((3, joints)), np.empty(joints)
    actuator = belief.actuator_nm.copy()
    last[:] = measured
    motion[:2] = measured
    flight = Flight(in_force, upcoming, newest, delay_ns)
    acts_ns = until_ns + int(1e9 * belief.lag_s[0])
    move(nominal, belief, drive, commands, flight, stamp_ns, acts_ns, motion, actuator, impulse)
    predicted[:] = motion[:2]
    if not (all_finite(predicted[0]) and all_finite(predicted[1])):
        # no motion of an arm: far beyond its speed, the model's numbers overflow
        predicted[:] = measured
    horizon_s = (acts_ns - stamp_ns) * 1e-9
    for i in range(joints):
        target[1, i] = predicted[1, i]
        target[0, i] = predicted[0, i] - horizon_s * predicted[1, i]
    return horizon_s
