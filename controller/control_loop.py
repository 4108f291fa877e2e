"""The control loop: receive a joint state, update the law, send torques.

The loop has no clock: a joint state drives each cycle, and its stamp is the time. So the same
states give the same torques, bit for bit, in a simulation, over a bus and in a replay.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InvalidMessageError, Rejections
from bus_schema.limits import JointLimits, name_of
from bus_schema.link.interface import ControllerLink
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.messages.types import join_stamp
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.clock import own_kernel
from bus_schema.runtime.compiled import all_finite, bind
from bus_schema.runtime.modes import COMMANDABLE, Mode, Trigger, follow, mode_event
from bus_schema.runtime.randomness import is_seed_used
from controller.chunks.answer import checked_rows
from controller.chunks.switches import ChunkLog
from controller.compensation.command_timeline import CommandFeedback
from controller.compensation.delay_compensation import DelayCompensation
from controller.control_law import ControlLaw, Tracking
from controller.control_status import ControlStatus
from controller.cycle_messages import CycleMessages
from controller.errors import ControllerError, LawError, is_of_the_law
from controller.funnel import Funnel
from controller.reference import Reference
from controller.torque_guard import TorqueGuard

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ControlTask:
    """The controller's task: this arm, along this reference, inside this funnel.

    Attributes:
        law_name: name of the law, for error messages.
        limits: limits of torques and motion.
        compensation: predicts the state in which a torque will act; None for none.
        sends_targets: commands carry targets for drives that close their own loop.
        longest_step_s: time between states above which some were absent: the step of such a
            state is 0.
    """

    robot: RobotDescription
    reference: Reference
    funnel: Funnel
    law: ControlLaw
    law_name: str
    limits: JointLimits
    compensation: DelayCompensation | None = None
    sends_targets: bool = False
    longest_step_s: float = math.inf


class ControlLoop:
    """One cycle per joint state: read, update, write.

    The link's `spin` is the loop: it calls `cycle` for each state that arrives. Call `stop` and
    `end` after it has returned.

    Attributes:
        mode: the controller's mode; it changes by `bus_schema.runtime.modes.TRANSITIONS`.
        cycles: states answered with a new torque.
        late: states no newer than the newest seen, answered with the torque in force.
        rejections: unusable states, which are not answered.
        tracking: the situation at the newest state.
        stamp_ns: stamp of the newest state; -1 before the first.
    """

    def __init__(self, task: ControlTask, link: ControllerLink) -> None:
        names = task.robot.joint_names
        self._task, self._link = task, link
        self._compensation = task.compensation
        announces = task.compensation is not None and task.compensation.announces
        rows, row_ticks = 1, 1
        if task.compensation is not None:
            rows, row_ticks = task.compensation.rows, task.compensation.row_ticks
        messages = self._messages = CycleMessages(
            names, rows, row_ticks, has_targets=task.sends_targets, has_acting_time=announces
        )
        self._command, self._torques_nm = messages.command, messages.torques_nm
        self._target = messages.targets[:, 0] if task.sends_targets else None
        self._bridge: Callable[[], None] | None = None
        if task.compensation is not None and rows > 1:
            bridge = task.compensation.bridge(messages.torques_nm, messages.targets, task.reference)
            self._bridge = bridge
        self._status = ControlStatus(messages.status, task.law, task.compensation)
        self.tracking = Tracking(task.robot.joints, messages.motion, messages.tracked)
        self._is_finite = bind(all_finite, messages.arrived.rows("position", "velocity"))
        self._guard = TorqueGuard(
            task.law_name, task.limits, self.tracking.motion, self._torques_nm[0]
        )
        self._target_of_law = getattr(task.law, "target", None) if task.sends_targets else None
        self._new_answers: Callable[[], list[str]] | None = getattr(task.law, "new_answers", None)
        self._start_ns = link.start_ns
        self._feedback: CommandFeedback | None = None
        self.stamp_ns = -1
        self.cycles = 0
        self.late = 0
        self.rejections = Rejections("joint state", logger)
        self.mode = Mode.IDLE
        self._events: list[tuple[EventKind, str]] = []
        self._change_mode(Trigger.BEGIN, "waiting for the first joint state")
        link.serve(self.cycle)

    def warm_up(self) -> None:
        """Compile the law before the run, without a trace in its state.

        Raises:
            ControllerError: the law raised, or returned no valid torque.
        """
        reference, funnel = self._task.reference, self._task.funnel
        situation = self.tracking
        situation.update(0.0, 0.0, reference, funnel)
        if self._compensation is not None:
            self._compensation.warm_up(self.tracking, reference, funnel)
            situation = self._compensation.predicted  # a law binds its kernels to these
        try:
            torque_nm = self._ask(situation)
            self._task.law.reset()
        except BaseException as error:
            raise self._as_law_error(error, None) from error
        self._guard.admit(torque_nm, 0, 0.0)
        self._guard.reset()
        # A message type's codec is created at its first use, which takes longer than a few ticks.
        RunEvent(0, Role.CONTROLLER, EventKind.STARTED, "").encode()

    def cycle(self, state: bytes, plant_status: bytes | None) -> None:
        """Answer one joint state.

        Raises:
            InvalidTorqueError: the law returned no valid torque.
            LawError: the law raised; the controller has stopped.
        """
        started_ns = time.perf_counter_ns()
        if self.mode not in COMMANDABLE:
            return
        try:
            if self._read(state, plant_status):
                self._update()
                sequence = self._write()
                self._report(sequence, started_ns)
        except Exception as error:
            self.stop(reason_of(error))
            raise

    def stop(self, reason: str) -> None:
        """Stop for a fault: send a zero torque without a target, ignoring rate limits."""
        if self.mode not in COMMANDABLE:
            return
        self._change_mode(Trigger.FAIL, "zero torque")
        self._command.stamp_ns = max(self.stamp_ns, 0)
        self._torques_nm[:] = 0.0
        if self._target is not None:
            self._messages.targets[:] = math.nan  # or the drives would follow the last one
        with contextlib.suppress(Exception):  # the bus may be the fault
            self._link.publish(topics.JOINT_COMMANDS, self._command.payload())
        self._change_mode(Trigger.STOPPED, "sends no more torques")
        self._events.append((EventKind.FAULT, reason))
        self._release_law()
        with contextlib.suppress(Exception):
            self._publish_events()

    def end(self) -> dict[str, object]:
        """End the run; return the counts."""
        if self.mode in COMMANDABLE:
            self._change_mode(Trigger.END, "sends no more torques")
            self._release_law()
        counts = {
            "cycles": self.cycles, "late": self.late, "rejected": self.rejections.counts,
            "limits": self._guard.counts.summary(), "kernel": own_kernel(),
            "newest_cycle_s": 1e-9 * self._status.cycle_started_ns, "seed_used": is_seed_used(),
        }  # fmt: skip
        log = getattr(self._task.law, "log", None)
        if isinstance(log, ChunkLog):
            counts |= {"starved": log.starved(), "chunks": log.summary()}
        self._events.append((EventKind.ENDED, json.dumps(counts)))
        self._publish_events()
        return counts

    def _read(self, state: bytes, plant_status: bytes | None) -> bool:
        """Read a state; return whether it requires a new torque."""
        messages = self._messages
        try:
            stamp_ns = messages.state_layout.decode(state, messages.arrived)
            if not self._is_finite():
                raise InvalidMessageError("not_finite", "a position or velocity is not finite")
        except InvalidMessageError as error:
            self.rejections.note(error)
            return False
        if self._start_ns is None or self._compensation is not None:
            start_ns = self._read_plant_status(plant_status, stamp_ns)
            self._start_ns = start_ns if self._start_ns is None else self._start_ns
        if stamp_ns <= self.stamp_ns:
            self.late += 1
            self._write()
            return False
        step_s = 1e-9 * (stamp_ns - self.stamp_ns) if self.stamp_ns >= 0 else 0.0
        step_s = step_s if step_s <= self._task.longest_step_s else 0.0
        self.stamp_ns = stamp_ns
        messages.accept()
        self.tracking.update(
            (stamp_ns - self._start_ns) * 1e-9, step_s, self._task.reference, self._task.funnel
        )  # fmt: skip
        return True

    def _read_plant_status(self, plant_status: bytes | None, stamp_ns: int) -> int:
        """Read the plant's report of the command in force and of the start of the run.

        A foreign plant reports nothing: the run begins with its first state.
        """
        start_ns, self._feedback, messages = stamp_ns, None, self._messages
        if plant_status is not None:
            try:
                messages.plant_status_layout.decode(plant_status, messages.plant_status)
            except InvalidMessageError as error:
                self.rejections.note(error)
            else:
                report = messages.plant_status.scalars
                start_ns = join_stamp(report.start_sec, report.start_nanosec)
                self._feedback = CommandFeedback(
                    report.command_sequence, report.command_delay_ns, report.arrival_delay_ns
                )
        return start_ns

    def _update(self) -> None:
        """Compute the torque for the situation, or its prediction, and write it as a command."""
        situation = self.tracking
        if self._compensation is not None:
            situation = self._compensation.predict(
                situation, self.stamp_ns, self._feedback, self._task.reference, self._task.funnel
            )
        try:
            torque_nm = self._ask(situation)
        except BaseException as error:  # a user's law may raise any exception
            raise self._as_law_error(error, self.cycles) from error
        self._guard.admit(torque_nm, self.cycles, self.tracking.step_s)

    def _ask(self, situation: Tracking) -> Vector:
        """Return the law's torque, and write its targets as a command if it has its own."""
        torque_nm = self._task.law.torque(situation)
        if self._target is not None and self._target_of_law is not None:
            wanted = self._target_of_law(situation)
            self._target[:] = checked_rows("targets", wanted, self._target.shape)
        return torque_nm

    def _release_law(self) -> None:
        """Release the law's resources; it is not called any more."""
        close = getattr(self._task.law, "close", None)
        try:
            if callable(close):
                close()
        except BaseException as error:
            if not is_of_the_law(error):
                raise
            self._events.append((EventKind.FAULT, str(self._as_law_error(error, self.cycles))))

    def _as_law_error(self, error: BaseException, tick: int | None) -> BaseException:
        """Return the exception to raise for an error within the law; a stop request stays."""
        return LawError(self._task.law_name, tick, error) if is_of_the_law(error) else error

    def _write(self) -> int:
        """Send the current torque in answer to the state that arrived; return its number."""
        self._command.stamp[:] = self._messages.arrived.stamp
        if self._target is not None and self._target_of_law is None:
            self._write_target(self._target)
        compensation = self._compensation
        if compensation is not None and compensation.announces:
            self._command.acts_after_ns = compensation.acts_after_ns
        if self._bridge is not None:
            self._bridge()
        sequence = self._link.publish(topics.JOINT_COMMANDS, self._command.payload())
        if compensation is not None:
            compensation.note_command(sequence, self._command.stamp_ns, self._torques_nm[0])
        return sequence

    def _write_target(self, target: Matrix) -> None:
        """Write the drives' target: from the prediction or, without one, the reference."""
        if self._compensation is not None:
            target[:] = self._compensation.target
        else:
            target[0] = self.tracking.reference_position
            target[1] = self.tracking.reference_velocity

    def _report(self, sequence: int, started_ns: int) -> None:
        """Publish the law's internal state and its timing; the torque has already been sent."""
        payload = self._status.encode(self._messages.state, self.cycles, sequence, started_ns)
        self._link.publish(topics.CONTROL_STATUS, payload)
        self.cycles += 1
        if self.cycles == 1:
            self._change_mode(Trigger.COMMAND, "first torque sent")
        if self._guard.hits:
            self._count_limit_hits()
        if self._new_answers is not None:
            self._events += [(EventKind.ANSWER, each) for each in self._new_answers()]
        if self._events:
            self._publish_events()

    def _count_limit_hits(self) -> None:
        new = self._guard.counts.note(self._guard.hits)
        if new:
            self._events.append((EventKind.LIMIT, f"reached for the first time: {name_of(new)}"))

    def _change_mode(self, trigger: Trigger, why: str) -> None:
        self.mode = follow(self.mode, trigger)
        self._events.append((EventKind.MODE, mode_event(self.mode, why)))

    def _publish_events(self) -> None:
        """Publish pending events; within a cycle, the torque has already been sent."""
        events, self._events = self._events, []
        now_ns = max(self.stamp_ns, self._link.cycle_ns, 0)
        for kind, detail in events:
            event = RunEvent(now_ns, Role.CONTROLLER, kind, detail)
            self._link.publish(topics.RUN_EVENTS, event.encode())


def reason_of(error: Exception) -> str:
    """Return the reason why a controller stopped, in one sentence; name unknown exceptions."""
    return str(error) if isinstance(error, ControllerError) else f"{type(error).__name__}: {error}"
