"""Delay compensation: a wrapper that gives a control law the future state in which it will act.

A torque sent now acts one horizon after the state it answers was measured: the round trip of the
bus, or the plant's play-out time if that is longer. So the law receives not the measured state but
the predicted one, with reference and funnel of that time. Any law can be wrapped, as it only
receives another `Tracking`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.drive_feedback import DriveGains
from bus_schema.registry import Registry
from bus_schema.runtime.compiled import bind
from controller.compensation.arm_belief import NominalArm, first_belief, forget
from controller.compensation.bridge import filling
from controller.compensation.command_timeline import (
    HELD,
    PIECES,
    CommandFeedback,
    HorizonSettings,
    forget_commands,
    no_commands,
    note,
)
from controller.compensation.continued_motion import forget_motion, no_motion
from controller.compensation.model_identification import Identification, start_again
from controller.compensation.motion_predictor import no_terms
from controller.compensation.prediction import Arm, foresee
from controller.compensation.rival_predictors import foresee_network, foresee_smith
from controller.control_law import Tracking
from controller.funnel import Funnel
from controller.reference import Reference

_NO_FEEDBACK = CommandFeedback(-1, 0)
"""Feedback that is plausible for no state."""
_LARGEST_NUMBER = 2**62

ADAPTIVE, HOLD_PREDICTION = "adaptive", "hold_prediction"
COMMUNICATION_DISTURBANCE_OBSERVER = "communication_disturbance_observer"
_SHIPPED = {
    ADAPTIVE: foresee,
    HOLD_PREDICTION: foresee,
    "smith": foresee_smith,
    COMMUNICATION_DISTURBANCE_OBSERVER: foresee_network,
}
PREDICTORS: Registry[Callable[..., float]] = Registry(
    "predictors", "controller.delay_compensation.predictor", type(foresee), _SHIPPED
)
"""Compiled functions by predictor. `HOLD_PREDICTION` is the default one that learns nothing."""


class DelayCompensation:
    """Predictor of the state in which a command will act.

    Args:
        nominal: the nominal arm.
        identification: the filter for its model, in its initial state.
        drive: gains of the drives' own loops.
        observer_bandwidth_rad_s: how fast disturbances are learned.
        predictor: one of `PREDICTORS`.
        horizon: how the time from a state until the torque that answers it acts is chosen.

    Attributes:
        announces: whether each command has to say when it acts: one horizon after its stamp.
        rows: rows of a command, with its first.
        row_ticks: ticks from one of them to the next.
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
        predictor: str = ADAPTIVE,
    ) -> None:
        joints = nominal.limits_nm.size
        self.announces = horizon.is_announced
        self.rows = 1 + PIECES if horizon.row_ticks else 1
        self.row_ticks = max(1, horizon.row_ticks)
        self.commands = no_commands(joints, horizon)
        self.belief = first_belief(nominal)
        self.identification = identification
        self.predicted = Tracking(joints)
        self.target: Matrix = np.zeros((2, joints))
        self._actuator_ns = horizon.actuator_ns
        self._longest_step_s = 1e-9 * horizon.longest_step_ns
        self._reports: deque[tuple[int, CommandFeedback]] = deque()
        self._bandwidth_rad_s = 0.0 if predictor == HOLD_PREDICTION else observer_bandwidth_rad_s
        self._kernel = PREDICTORS[predictor]
        self._arm = Arm(
            nominal, self.belief, identification, drive, self.commands,
            np.zeros((2, joints)), np.zeros(2, np.int64), np.zeros((4, joints)),
            no_terms(joints), no_motion(joints),
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

    @property
    def acts_after_ns(self) -> int:
        """Time from a state until the command that answers it has to be at the drives."""
        return self.horizon_ns - self._actuator_ns

    def reset(self) -> None:
        """Forget all commands and everything learned."""
        self._reports.clear()
        forget_commands(self.commands)
        forget(self._arm.nominal, self.belief)
        start_again(self.identification)
        self._arm.last_answered[:] = 0, HELD
        self._arm.memory[:] = 0.0
        forget_motion(self._arm.continued)

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
        elif self._actuator_ns:
            sequence, delay_ns, arrival_ns = self._acting(stamp_ns, feedback or _NO_FEEDBACK)
        horizon_s = self._foresee(stamp_ns, sequence, delay_ns, arrival_ns)
        self.predicted.horizon_s = horizon_s
        time_s = measured.time_s + horizon_s
        step_s = measured.step_s if measured.step_s <= self._longest_step_s else 0.0
        self.predicted.update(time_s, step_s, reference, funnel)
        return self.predicted

    def _acting(self, stamp_ns: int, feedback: CommandFeedback) -> CommandFeedback:
        """Return what a state reports about commands that have passed the actuators.

        A plant reports the command at the drives. It acts after their dead time.
        """
        reports, passed_ns = self._reports, stamp_ns - self._actuator_ns
        reports.append((stamp_ns, feedback))
        while len(reports) > 1 and reports[1][0] <= passed_ns:
            reports.popleft()
        reported_ns, (sequence, delay_ns, arrival_ns) = reports[0]
        if reported_ns > passed_ns:
            return CommandFeedback(HELD, 0)
        arrival_ns += self._actuator_ns if arrival_ns >= 0 else 0
        return CommandFeedback(sequence, delay_ns + self._actuator_ns, arrival_ns)

    def _bind(self, measured: Tracking) -> None:
        """Bind the arguments of compiled code: determining their types costs more than the work."""
        self._measured = measured
        self._foresee = bind(
            self._kernel, self._arm, self._bandwidth_rad_s, measured.motion, measured.error,
            measured.bounds, self.predicted.motion, self.target, free=["int64"] * 4,
        )  # fmt: skip
