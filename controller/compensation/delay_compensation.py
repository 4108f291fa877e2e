"""Delay compensation: a wrapper that gives a control law the future state in which it will act.

A torque sent now acts one horizon after the state it answers was measured: the round trip of the
bus, or the plant's play-out time if that is longer. So the law receives not the measured state but
the predicted one, with reference and funnel of that time. Any law can be wrapped, as it only
receives another `Tracking`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.drive_feedback import DriveGains
from bus_schema.runtime.compiled import all_finite, bind, compiled
from controller.compensation.arm_belief import ArmBelief, NominalArm, first_belief, forget
from controller.compensation.bridge import filling
from controller.compensation.command_timeline import (
    CAPACITY,
    HELD,
    LONGEST_HORIZON_NS,
    CommandFeedback,
    Commands,
    Flight,
    HorizonSettings,
    ahead,
    assumed_in_force,
    explains,
    forget_commands,
    no_commands,
    note,
    observe,
    schedule,
)
from controller.compensation.model_identification import Identification, start_again, take_in
from controller.compensation.motion_predictor import move
from controller.control_law import LOWER, UPPER, Tracking
from controller.funnel import Funnel
from controller.reference import Reference
from controller.rigid_bodies.dynamics import mass_matrix

_LARGEST_NM = 1e6
"""Largest disturbance of a plausible state: nothing is learned from a larger one."""


@compiled
def learn_disturbance(
    mass: Matrix, velocity: Vector, predicted_velocity: Vector, step_s: float, gain: float,
    disturbance: Vector,
) -> bool:  # fmt: skip
    """Update the disturbance from the prediction error over a step; return whether it is plausible.

    A constant disturbance is followed with 1 − e^(−bandwidth × time), at any length of the steps.

    Args:
        mass: M(q), kg m², shape (joints, joints).
        velocity: measured at the end of the step, rad/s, shape (joints,).
        predicted_velocity: the model's prediction from the state at its start, rad/s.
        step_s: its length.
        gain: 1 − e^(−bandwidth × step).
        disturbance: f, driving, N m, changed in place.
    """
    joints = velocity.size
    for i in range(joints):
        for j in range(joints):
            missed = mass[i, j] * (velocity[j] - predicted_velocity[j]) / step_s
            if not -_LARGEST_NM < missed < _LARGEST_NM:
                return False
    for i in range(joints):
        missed = 0.0
        for j in range(joints):
            missed += mass[i, j] * (velocity[j] - predicted_velocity[j])
        disturbance[i] += gain * missed / step_s
    return True


_NO_FEEDBACK = CommandFeedback(-1, 0)
"""Feedback that is plausible for no state."""
_LARGEST_NUMBER = 2**62


class Arm(NamedTuple):
    """All inputs of a prediction, for compiled code.

    Attributes:
        nominal: the nominal arm.
        belief: the current belief about it.
        identification: the filter that updates the belief.
        drive: gains of the drives' own loops.
        commands: all that were sent.
        last: position and velocity of the state answered last as rows, shape (2, joints).
        last_answered: its stamp in ns and the command in force at it, `HELD` for none; shape (2,).
    """

    nominal: NominalArm
    belief: ArmBelief
    identification: Identification
    drive: DriveGains
    commands: Commands
    last: Matrix
    last_answered: NDArray[np.int64]


class DelayCompensation:
    """Predictor of the state in which a command will act.

    Args:
        nominal: the nominal arm.
        identification: the filter for its model, in its initial state.
        drive: gains of the drives' own loops.
        observer_bandwidth_rad_s: how fast disturbances are learned.
        horizon: how the time from a state until the torque that answers it acts is chosen.

    Attributes:
        announces: whether each command has to say when it acts: one horizon after its stamp.
        rows: rows of a command, with its first.
        commands: those sent, and the horizon.
        belief: the belief about the arm.
        identification: the filter that updates the belief.
        predicted: the latest prediction.
        target: this prediction as a target for the drives, at the stamp of the answered state:
            position, rad, and velocity, rad/s, as rows; shape (2, joints).
    """

    def __init__(
        self,
        nominal: NominalArm,
        identification: Identification,
        drive: DriveGains,
        *,
        observer_bandwidth_rad_s: float,
        horizon: HorizonSettings,
    ) -> None:
        joints = nominal.limits_nm.size
        self.announces = horizon.is_announced
        self.rows = 1 + horizon.bridge_rows
        self.commands = no_commands(joints, horizon)
        self.belief = first_belief(nominal)
        self.identification = identification
        self.predicted = Tracking(joints)
        self.target: Matrix = np.zeros((2, joints))
        self._bandwidth_rad_s = observer_bandwidth_rad_s
        self._arm = Arm(
            nominal, self.belief, identification, drive, self.commands,
            np.zeros((2, joints)), np.zeros(2, np.int64),
        )  # fmt: skip
        self._measured: Tracking | None = None
        self._torque_nm: Vector = np.zeros(joints)
        sent = (self.commands, self._torque_nm, self.target)
        self._note = bind(note, *sent, free=["int64", "int64"])
        self.reset()

    @property
    def horizon_ns(self) -> int:
        """Expected time from a state until the torque that answers it acts."""
        return int(self.commands.state["horizon_ns"][0])

    def reset(self) -> None:
        """Forget all commands and everything learned."""
        forget_commands(self.commands)
        forget(self._arm.nominal, self.belief)
        start_again(self.identification)
        self._arm.last_answered[:] = 0, HELD

    def warm_up(self, measured: Tracking, reference: Reference, funnel: Funnel) -> None:
        """Compile everything before the run, without a trace in the state."""
        self.note_command(1, 0, measured.velocity)
        for stamp_ns in (1_000_000, 2_000_000):
            self.predict(measured, stamp_ns, CommandFeedback(1, stamp_ns), reference, funnel)
        self.reset()

    def bridge(
        self, torques_nm: Matrix, targets: NDArray[np.float64], reference: Reference
    ) -> Callable[[], None]:
        """Return a function that fills the rows of a command after its first; see `filling`."""
        nominal, predicted = self._arm.nominal, self.predicted
        return filling(
            nominal, self.belief, self.commands, predicted, reference, torques_nm, targets
        )

    def note_command(self, number: int, stamp_ns: int, torque_nm: Vector) -> None:
        """Note a command sent in answer to the state of `stamp_ns`; numbers increase."""
        self._torque_nm[:] = torque_nm
        self._note(number, stamp_ns)

    def predict(
        self,
        measured: Tracking,
        stamp_ns: int,
        feedback: CommandFeedback | None,
        reference: Reference,
        funnel: Funnel,
    ) -> Tracking:
        """Return the situation in which the answer to a state will act.

        Args:
            measured: the situation at the state; states come in order.
            stamp_ns: stamp of the state.
            feedback: the command in force at it; None if the plant does not report it.
            reference: the reference of `measured`.
            funnel: the funnel of `measured`.
        """
        if measured is not self._measured:
            self._bind(measured)
        sequence, delay_ns, arrival_ns = feedback or _NO_FEEDBACK
        if not HELD <= sequence <= _LARGEST_NUMBER:
            sequence, delay_ns, arrival_ns = _NO_FEEDBACK
        horizon_s = self._foresee(stamp_ns, sequence, delay_ns, arrival_ns)
        self.predicted.horizon_s = horizon_s
        time_s = measured.time_s + horizon_s
        self.predicted.update(time_s, measured.step_s, reference, funnel)
        return self.predicted

    def _bind(self, measured: Tracking) -> None:
        """Bind the arguments of compiled code: determining their types costs more than the work."""
        self._measured = measured
        self._foresee = bind(
            _foresee, self._arm, self._bandwidth_rad_s, measured.motion, measured.error,
            measured.bounds, self.predicted.motion, self.target, free=["int64"] * 4,
        )  # fmt: skip


@compiled
def _foresee(
    arm: Arm, bandwidth_rad_s: float, measured: Matrix, error: Vector, bounds: Matrix,
    predicted: Matrix, target: Matrix, stamp_ns: int, sequence: int, delay_ns: int, arrival_ns: int,
) -> float:  # fmt: skip
    """Learn from a state, and predict for its answer into `predicted`; return the horizon."""
    commands, (last_ns, last_in_force) = arm.commands, arm.last_answered
    if explains(commands, sequence, delay_ns, stamp_ns):
        observe(commands, CommandFeedback(sequence, delay_ns, arrival_ns), stamp_ns, last_ns)
        if delay_ns <= commands.announced_ns[sequence % CAPACITY]:
            delay_ns = 0  # it acted when it said so, and so did those before
    else:
        sequence = assumed_in_force(commands, stamp_ns)
        delay_ns = commands.state[0].horizon_ns
    if HELD < last_in_force <= sequence and stamp_ns - last_ns <= LONGEST_HORIZON_NS:
        acted = schedule(commands, last_in_force, sequence, delay_ns, last_ns)
        gain = 1.0 - math.exp(-bandwidth_rad_s * 1e-9 * (stamp_ns - last_ns))
        _learn(arm, measured, error, bounds, acted, last_ns, stamp_ns, gain)
    arm.last_answered[0], arm.last_answered[1] = stamp_ns, sequence
    arm.last[:] = measured
    flight = ahead(commands, sequence, stamp_ns)
    until_ns = stamp_ns + commands.state[0].horizon_ns
    return _predict(arm, measured, predicted, target, flight, stamp_ns, until_ns)


@compiled
def _learn(
    arm: Arm, measured: Matrix, error: Vector, bounds: Matrix, flight: Flight,
    last_ns: int, stamp_ns: int, gain: float,
) -> None:  # fmt: skip
    """Compare the arm's motion since the last state with the prediction."""
    nominal, belief, identification, drive, commands, last, _ = arm
    joints, step_s = error.size, (stamp_ns - last_ns) * 1e-9
    motion, impulse = np.empty((3, joints)), np.empty(joints)
    actuator, actuator_before = belief.actuator_nm.copy(), belief.actuator_nm.copy()
    motion[:2] = last
    move(nominal, belief, drive, commands, flight, last_ns, stamp_ns, motion, actuator, impulse)
    mass = np.empty((joints, joints))
    mass_matrix(nominal.bodies, belief.inertia, measured[0], mass)
    if not all_finite(actuator):
        return
    belief.actuator_nm[:] = actuator
    if not learn_disturbance(mass, measured[1], motion[1], step_s, gain, belief.disturbance_nm):
        return
    if identification.is_active and _is_inside(error, bounds):
        take_in(nominal, identification, belief, last, measured, actuator_before, impulse, step_s)
    else:
        identification.window.elapsed_s[0] = 0.0


@compiled
def _is_inside(error: Vector, bounds: Matrix) -> bool:
    """Whether all errors are inside the funnel: a lost arm's motion teaches nothing useful."""
    for i in range(error.size):  # noqa: SIM110 (numba compiles no generators)
        if not -bounds[LOWER, i] < error[i] < bounds[UPPER, i]:
            return False
    return True


@compiled
def _predict(
    arm: Arm, measured: Matrix, predicted: Matrix, target: Matrix, flight: Flight,
    stamp_ns: int, until_ns: int,
) -> float:  # fmt: skip
    """Predict the state in which a torque acts into `predicted`, (2, joints); return the span."""
    nominal, belief, _, drive, commands, _, _ = arm
    joints = measured.shape[1]
    motion, impulse = np.empty((3, joints)), np.empty(joints)
    actuator = belief.actuator_nm.copy()
    motion[:2] = measured
    acts_ns = until_ns + int(1e9 * belief.lag_s[0])
    move(nominal, belief, drive, commands, flight, stamp_ns, acts_ns, motion, actuator, impulse)
    predicted[:] = motion[:2]
    if not (all_finite(predicted[0]) and all_finite(predicted[1])):
        # no real motion: at such speeds the model's numbers overflow
        predicted[:] = measured
    horizon_s = (acts_ns - stamp_ns) * 1e-9
    for i in range(joints):
        target[1, i] = predicted[1, i]
        target[0, i] = predicted[0, i] - horizon_s * predicted[1, i]
    return horizon_s
