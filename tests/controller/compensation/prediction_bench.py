"""A delay compensation at an arm whose true motion is integrated in small steps."""

import numpy as np

from bus_schema.drive_feedback import no_drive_feedback
from controller.compensation.arm_belief import nominal_arm
from controller.compensation.command_timeline import CommandFeedback, HorizonSettings
from controller.compensation.delay_compensation import DelayCompensation
from controller.compensation.model_identification import identification
from controller.control_law import Tracking
from controller.funnel import Funnel
from controller.manipulator_model import ManipulatorModel
from controller.reference import JointSinusoids
from tests.arms import PAPER_ARM, forward_dynamics

MS = 1_000_000
ROBOT = PAPER_ARM
MODEL = ManipulatorModel(ROBOT)
LOADED = ManipulatorModel(ROBOT, payload_kg=1.0)
START = np.array([0.2, -0.7, 1.1])
INERTIA = MODEL.governing_inertia(START[None])
LIMITS = ROBOT.effort_limits_nm
SWING = JointSinusoids(np.array([0.1, -0.5, 0.8]), np.array([[[0.1, 2.0, 0.3]] * 3]))
FUNNEL = Funnel(np.full(3, 0.3), np.full(3, 0.3), np.full(3, 0.01), 4.0)
_STEPS = 10


def compensation_of(
    *, model=False, friction=False, drive=None, limits=LIMITS, bandwidth_rad_s=60.0, least_ns=0,
    first_ns=0, rotors=None, horizon=None, predictor="adaptive",
):  # fmt: skip
    """A compensation for the paper's arm, which by default learns nothing but a disturbance."""
    nominal, loaded = MODEL, LOADED
    if rotors is not None:
        nominal = ManipulatorModel(ROBOT, rotor_inertia_kg_m2=rotors)
        loaded = ManipulatorModel(ROBOT, payload_kg=1.0, rotor_inertia_kg_m2=rotors)
    return DelayCompensation(
        nominal_arm(nominal, loaded, limits),
        identification(INERTIA, limits, model=model, friction=friction, rotors=rotors is not None),
        drive or no_drive_feedback(3),
        observer_bandwidth_rad_s=bandwidth_rad_s,
        horizon=horizon or HorizonSettings(least_ns=least_ns, first_ns=first_ns),
        predictor=predictor,
    )


def swing_about_gravity(tick, measured, _seen):
    """A torque that follows no reference."""
    swing = np.array([40.0, 60.0, 15.0]) * np.sin(0.02 * tick + np.arange(3))
    return MODEL.gravity(measured.position) + swing


class Bench:
    """A compensation at an arm whose true motion is integrated in steps of 0.1 ms.

    The torque that answers the state of a tick acts `delay` ticks later; a command whose tick is in
    `lost` never arrives.

    Args:
        compensation: what is tested; one with these settings by default.
        plant: the true rigid bodies.
        missing: what else acts on them, N m, as a function of the velocity.
        lag_s: of the actuators.
        lost: ticks whose commands are lost.
        law: torque for a tick, the state measured and the one foreseen.
        reference: what the states are measured against, with `funnel`.
        drive: what the drives add of their own, in truth and by the compensation's belief.
    """

    def __init__(
        self, compensation=None, *, plant=MODEL, missing=None, lag_s=0.0, lost=(),
        law=swing_about_gravity, reference=SWING, funnel=FUNNEL, drive=None, **settings,
    ):  # fmt: skip
        self.compensation = compensation or compensation_of(drive=drive, **settings)
        self.plant, self.lag_s, self.lost, self.law = plant, lag_s, lost, law
        self.missing = missing or (lambda velocity: np.zeros(3))
        self.reference, self.funnel = reference, funnel
        self.drive = drive or no_drive_feedback(3)
        self.measured = Tracking(3)
        self.measured.position[:] = START
        self.predicted, self.truth, self.in_force = {}, {}, (0, -1, None)
        self.sent, self.tick, self.actuator = {}, 0, None
        self._numbers = {}

    def run(self, ticks, delay, *, gives_feedback=True):
        """Ticks with a state each, which comes with or without feedback."""
        for _ in range(ticks):
            self.answer(gives_feedback=gives_feedback)
            self.fly(1, delay)

    def answer(self, *, gives_feedback=True):
        """Answer the state of this tick."""
        tick, state = self.tick, self.measured
        state.update(tick * 1e-3, 1e-3 if tick else 0.0, self.reference, self.funnel)
        feedback = CommandFeedback(*self.in_force[:2]) if gives_feedback else None
        seen = self.compensation.predict(state, tick * MS, feedback, self.reference, self.funnel)
        horizon_ms = 1e3 * seen.horizon_s
        self.predicted[tick] = horizon_ms, seen.position.copy(), seen.velocity.copy()
        torque = self.law(tick, state, seen)
        self.sent[tick] = torque, self.compensation.target.copy()
        self._numbers[tick] = len(self.sent)
        self.compensation.note_command(len(self.sent), tick * MS, torque)

    def fly(self, ticks, delay):
        """Ticks in which no state is answered, or no other one."""
        for _ in range(ticks):
            self.truth[self.tick] = self.measured.position.copy(), self.measured.velocity.copy()
            self._let_act(self.tick - delay, self.tick)
            self._move()
            self.tick += 1
            self._let_act(self.tick - delay, self.tick)

    def _let_act(self, answered, now):
        number = 0 if answered in self.lost else self._numbers.get(answered, 0)
        if number > self.in_force[0]:
            self.in_force = number, (now - answered) * MS, answered

    def _move(self):
        if self.in_force[2] is None:
            return
        step_s, state, answered = 1e-3 / _STEPS, self.measured, self.in_force[2]
        torque, target = self.sent[answered]
        for step in range(_STEPS):
            asked, age_s = torque.copy(), (self.tick - answered) * 1e-3 + step * step_s
            if self.drive.is_active:
                away = target[0] + age_s * target[1] - state.position
                asked += self.drive.stiffness_nm_rad * away
                asked += self.drive.damping_nm_s * (target[1] - state.velocity)
                asked = np.clip(asked, -LIMITS, LIMITS)
            if self.actuator is None:
                self.actuator = np.zeros(3)
            left = np.exp(-step_s / self.lag_s) if self.lag_s else 0.0
            self.actuator = asked + left * (self.actuator - asked)
            pull = self.actuator + self.missing(state.velocity)
            change = step_s * forward_dynamics(self.plant, state.position, state.velocity, pull)
            state.position += step_s * (state.velocity + 0.5 * change)
            state.velocity += change

    def prediction_error(self, ticks):
        """Largest error of predictions made at these ticks: of positions, of velocities."""
        errors = []
        for tick in ticks:
            horizon_ms, position, velocity = self.predicted[tick]
            truth = self.truth[tick + round(horizon_ms)]
            errors.append((np.abs(position - truth[0]).max(), np.abs(velocity - truth[1]).max()))
        return np.max(errors, axis=0)
