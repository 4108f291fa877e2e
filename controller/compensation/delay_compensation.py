"""Delay compensation: a wrapper that shows a control law the future it will act in.

A torque sent now acts one horizon after the state it answers was measured: the round trip of the
bus, or the plant's play-out time if that is longer. So the law is given not the measured state but
the one that the arm will be in by then, with reference and funnel of that time. Any law can be
wrapped, as it sees nothing but another `Tracking`.
"""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.runtime.finite import all_finite
from controller.compensation.command_timeline import (
    HELD,
    LONGEST_HORIZON_NS,
    CommandFeedback,
    CommandTimeline,
)
from controller.compensation.disturbance_observer import DisturbanceObserver
from controller.compensation.motion_predictor import SMOOTHING_RAD_S, MotionPredictor
from controller.control_law import Tracking
from controller.funnel import Funnel
from controller.manipulator_model import ManipulatorModel
from controller.reference import Reference


class DelayCompensation:
    """Predicts the state in which a command will act.

    Args:
        model: the nominal model.
        observer_bandwidth_rad_s: how fast disturbances are learned.
        learn_friction: whether Coulomb friction is learned too, so that its flip is predicted.
        least_horizon_ns: no torque acts sooner than this after the state it answers.

    Attributes:
        timeline: the commands sent, and the horizon.
        predicted: the situation predicted last.
        missing: what the nominal model was found to miss.
    """

    def __init__(
        self,
        model: ManipulatorModel,
        *,
        observer_bandwidth_rad_s: float,
        learn_friction: bool,
        least_horizon_ns: int,
    ) -> None:
        joints = model.joints
        self._model = model
        self.timeline = CommandTimeline(joints, least_horizon_ns)
        self.missing = DisturbanceObserver(
            joints, observer_bandwidth_rad_s, learn_friction=learn_friction
        )
        self._predictor = MotionPredictor(model, self.missing)
        self.predicted = Tracking(joints)
        self._last_position: Vector = np.zeros(joints)
        self._last_velocity: Vector = np.zeros(joints)
        self.reset()

    def reset(self) -> None:
        """Forget all commands and all that was learned."""
        self.timeline.reset()
        self.missing.reset()
        self._last_in_force, self._last_ns = HELD, 0

    def warm_up(self, measured: Tracking, reference: Reference, funnel: Funnel) -> None:
        """Compile everything before time counts, and leave no trace of it."""
        self.note_command(1, 0, measured.velocity)
        for stamp_ns in (1_000_000, 2_000_000):
            self.predict(measured, stamp_ns, CommandFeedback(1, stamp_ns), reference, funnel)
        self.reset()

    def note_command(self, number: int, stamp_ns: int, torque_nm: Vector) -> None:
        """A command was sent in answer to the state of `stamp_ns`; numbers increase."""
        self.timeline.note(number, stamp_ns, torque_nm)

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
        timeline = self.timeline
        if feedback is not None and timeline.explains(feedback, stamp_ns):
            timeline.observe(feedback, stamp_ns)
        else:
            feedback = CommandFeedback(timeline.assumed_in_force(stamp_ns), timeline.horizon_ns)
        is_moving = HELD < self._last_in_force <= feedback.sequence
        if is_moving and stamp_ns - self._last_ns <= LONGEST_HORIZON_NS:
            self._learn(measured, stamp_ns, feedback)
        self._last_in_force, self._last_ns = feedback.sequence, stamp_ns
        self._last_position[:], self._last_velocity[:] = measured.position, measured.velocity

        horizon_ns, predictor = timeline.horizon_ns, self._predictor
        ahead = timeline.ahead(feedback.sequence, stamp_ns)
        predictor.predict(
            measured.position, measured.velocity, ahead, stamp_ns, stamp_ns + horizon_ns
        )
        if not (all_finite(predictor.position) and all_finite(predictor.velocity)):
            # no motion of an arm: far beyond its speed, the model's numbers overflow
            predictor.position[:], predictor.velocity[:] = measured.position, measured.velocity
        self.predicted.position[:] = predictor.position
        self.predicted.velocity[:] = predictor.velocity
        time_s = measured.time_s + horizon_ns * 1e-9
        self.predicted.update(time_s, measured.step_s, reference, funnel)
        return self.predicted

    def _learn(self, measured: Tracking, stamp_ns: int, feedback: CommandFeedback) -> None:
        """Compare how the arm moved since the last state with how it should have moved."""
        predictor, step_s = self._predictor, (stamp_ns - self._last_ns) * 1e-9
        acted = self.timeline.between(self._last_in_force, feedback, self._last_ns)
        predictor.predict(self._last_position, self._last_velocity, acted, self._last_ns, stamp_ns)
        mass = self._model.mass_matrix(measured.position)
        missed_nm = mass @ (measured.velocity - predictor.velocity) / step_s
        if not all_finite(missed_nm):
            return
        mean_velocity = 0.5 * (self._last_velocity + measured.velocity)
        self.missing.learn(
            missed_nm, np.diag(mass), np.tanh(mean_velocity / SMOOTHING_RAD_S), step_s
        )
