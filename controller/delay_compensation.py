"""Delay compensation."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Vector
from controller.command_timeline import HELD, CommandTimeline, Echo
from controller.control_law import Tracking
from controller.manipulator_model import ManipulatorModel
from controller.motion_predictor import MotionPredictor
from controller.prescribed_performance import Funnel
from controller.reference import Reference


class DelayCompensation:
    def __init__(self, model, observer_bandwidth_rad_s, least_horizon_ns):
        joints = model.joints
        self._model = model
        self._bandwidth = observer_bandwidth_rad_s
        self.timeline = CommandTimeline(joints, least_horizon_ns)
        self.predictor = MotionPredictor(model)
        self._foreseen = Tracking(joints)
        self._foreseen.position = self.predictor.position
        self._foreseen.velocity = self.predictor.velocity
        self._last_position: Vector = np.zeros(joints)
        self._last_velocity: Vector = np.zeros(joints)
        self.reset()

    def reset(self):
        self.timeline.reset()
        self.predictor.disturbance[:] = 0.0
        self._last_in_force = HELD
        self._last_ns = -1

    def note_command(self, number, stamp_ns, torque):
        self.timeline.note(number, stamp_ns, torque)

    def foresee(self, tracking: Tracking, stamp_ns: int, echo: Echo | None, reference, funnel):
        timeline = self.timeline
        if echo is None or not timeline.knows(echo.sequence):
            echo = Echo(timeline.assumed_in_force(stamp_ns), timeline.horizon_ns)
        else:
            timeline.observe(echo, stamp_ns)
        if self._last_in_force != HELD:
            self._learn(tracking, stamp_ns, echo)
        self._last_in_force, self._last_ns = echo.sequence, stamp_ns
        self._last_position[:], self._last_velocity[:] = tracking.position, tracking.velocity
        horizon_ns = timeline.horizon_ns
        self.predictor.predict(
            tracking.position, tracking.velocity, timeline.ahead(echo.sequence, stamp_ns),
            stamp_ns, stamp_ns + horizon_ns,
        )
        self._foreseen.update(
            tracking.time_s + horizon_ns * 1e-9, tracking.step_s, reference, funnel
        )
        return self._foreseen

    def _learn(self, tracking, stamp_ns, echo):
        self.predictor.predict(
            self._last_position, self._last_velocity,
            self.timeline.between(self._last_in_force, echo, self._last_ns),
            self._last_ns, stamp_ns,
        )
        step_s = (stamp_ns - self._last_ns) * 1e-9
        gain = 1.0 - math.exp(-self._bandwidth * step_s)
        missed = (tracking.velocity - self.predictor.velocity) * (gain / step_s)
        self.predictor.disturbance += self._model.mass_matrix(tracking.position) @ missed
