"""The control loop: receive a joint state, update the law, send torques.

The loop has no clock of its own: a joint state drives each cycle, and its stamp is the time. So the
same states give the same torques, bit for bit, in a simulation, over a bus and in a replay.
"""

from __future__ import annotations

import contextlib
import json
import logging
import time
from dataclasses import dataclass

import numpy as np

from bus_schema.errors import InvalidMessageError
from bus_schema.limits import name_of
from bus_schema.link.interface import ControllerLink
from bus_schema.messages import topics
from bus_schema.messages.layout import Record
from bus_schema.messages.rejections import Rejections
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import bind
from bus_schema.runtime.finite import all_finite
from bus_schema.runtime.modes import COMMANDABLE, Cue, Mode, follow, mode_event
from controller.compensation.command_timeline import Echo
from controller.compensation.delay_compensation import DelayCompensation
from controller.control_law import ControlLaw, Tracking
from controller.funnel import Funnel
from controller.reference import Reference
from controller.torque_guard import ControllerError, TorqueGuard

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ControlTask:
    """What the controller has to do: this arm, along this reference, inside this funnel."""

    robot: RobotDescription
    reference: Reference
    funnel: Funnel
    law: ControlLaw
    guard: TorqueGuard
    compensation: DelayCompensation | None = None


class ControlLoop:
    """One cycle per joint state: read, update, write.

    Attributes:
        mode: what the controller does; changes as `bus_schema.runtime.modes.TRANSITIONS` has it.
        cycles: states answered with a torque of their own.
        late: states older than the newest seen, answered with the torque in force.
        rejections: unusable states, which are not answered.
        tracking: the situation at the newest state.
        stamp_ns: stamp of the newest state; -1 before the first.
    """

    def __init__(self, task: ControlTask, link: ControllerLink) -> None:
        names = task.robot.joint_names
        self._task = task
        self._compensation = task.compensation
        self._link = link
        self._state_layout = topics.layout(topics.JOINT_STATES, names)
        self._plant_status_layout = topics.layout(topics.PLANT_STATUS, names)
        self._state = Record(self._state_layout)
        self._plant_status = Record(self._plant_status_layout)
        self._command = Record(topics.layout(topics.JOINT_COMMANDS, names))
        self._status = Record(topics.layout(topics.CONTROL_STATUS, names))
        motion = self._state.matrix("position", "velocity")
        self._is_finite = bind(all_finite, motion)
        self._effort = self._command.fields["effort"]
        self.tracking = self._tracking_in_status()
        self._start_ns: int | None = None
        self._echo: Echo | None = None
        self._horizon_ns = 0
        self.stamp_ns = -1
        self._cycle_started_ns = 0
        self.cycles = 0
        self.late = 0
        self.rejections = Rejections("joint state", logger)
        self.mode = Mode.IDLE
        self._to_announce: list[tuple[EventKind, str]] = []
        task.guard.attach(motion, self._effort)
        self._change_mode(Cue.BEGIN, "waiting for the first joint state")
        link.serve(self.cycle)

    def warm_up(self) -> None:
        """Compile the law before time counts, and leave no trace of it."""
        reference, funnel = self._task.reference, self._task.funnel
        self.tracking.update(0.0, 0.0, reference, funnel)
        if self._compensation is not None:
            self._compensation.warm_up(self.tracking, reference, funnel)
        self._task.guard.admit(self._task.law.torque(self.tracking), 0, 0.0)
        self._task.law.reset()
        self._task.guard.reset()
        # The codec of a message type is made at its first use, which takes longer than a few ticks.
        RunEvent(0, Role.CONTROLLER, EventKind.STARTED, "").encode()

    def cycle(self, state: bytes, plant_status: bytes | None) -> None:
        """Answer one joint state.

        Raises:
            InvalidTorqueError: the law returned something that is no torque.
            Exception: whatever else the law raised; the controller has stopped then.
        """
        started_ns = time.perf_counter_ns()
        if self.mode is Mode.FAULT:
            return
        try:
            if self._read(state, plant_status):
                self._update()
                self._command.stamp[0] = self._state.stamp[0]
                sequence = self._send()
                self._report(sequence, started_ns)
        except Exception as error:
            self.stop(reason_of(error))
            raise

    def stop(self, reason: str) -> None:
        """Stop for a fault: the last torque that is sent is zero, whatever the rate limits say."""
        if self.mode not in COMMANDABLE:
            return
        self._change_mode(Cue.FAIL, "zero torque")
        self._command.stamp_ns = max(self.stamp_ns, 0)
        self._effort[:] = 0.0
        with contextlib.suppress(Exception):  # the bus may be what has failed
            self._link.publish(topics.JOINT_COMMANDS, self._command.payload())
        self._change_mode(Cue.STOPPED, "gives no more torques")
        self._to_announce.append((EventKind.FAULT, reason))
        with contextlib.suppress(Exception):
            self._announce()

    def end(self) -> dict[str, object]:
        """Say goodbye; what was counted."""
        if self.mode in COMMANDABLE:
            self._change_mode(Cue.END, "gives no more torques")
        counts = {
            "cycles": self.cycles, "late": self.late, "rejected": self.rejections.counts,
            "limits": self._task.guard.counts.summary(),
        }  # fmt: skip
        self._to_announce.append((EventKind.ENDED, json.dumps(counts)))
        self._announce()
        return counts

    def _read(self, state: bytes, plant_status: bytes | None) -> bool:
        """Take in a state; whether it calls for a new torque."""
        try:
            stamp_ns = self._state_layout.decode(state, self._state)
            if not self._is_finite():
                raise InvalidMessageError("not_finite", "a position or velocity is not finite")
        except InvalidMessageError as error:
            self.rejections.note(error)
            return False
        if self._start_ns is None or self._compensation is not None:
            start_ns = self._heed(plant_status, stamp_ns)
            self._start_ns = start_ns if self._start_ns is None else self._start_ns
        if stamp_ns <= self.stamp_ns:
            self.late += 1
            self._command.stamp_ns = stamp_ns
            self._send()
            return False
        step_ns = stamp_ns - self.stamp_ns if self.stamp_ns >= 0 else 0
        self.stamp_ns = stamp_ns
        self.tracking.update(
            (stamp_ns - self._start_ns) * 1e-9, step_ns * 1e-9, self._task.reference,
            self._task.funnel,
        )  # fmt: skip
        return True

    def _update(self) -> None:
        situation = self.tracking
        if self._compensation is not None:
            situation = self._compensation.foresee(
                situation, self.stamp_ns, self._echo, self._task.reference, self._task.funnel
            )
            self._horizon_ns = self._compensation.timeline.horizon_ns
        torque = self._task.law.torque(situation)
        self._task.guard.admit(torque, self.cycles, self.tracking.step_s)  # into the command

    def _send(self) -> int:
        """Send the command as it stands; its number."""
        sequence = self._link.publish(topics.JOINT_COMMANDS, self._command.payload())
        if self._compensation is not None:
            self._compensation.note_command(sequence, self._command.stamp_ns, self._effort)
        return sequence

    def _report(self, sequence: int, started_ns: int) -> None:
        """Publish what the law thought and how long it took; the torque is already on its way."""
        step_ns = time.perf_counter_ns() - started_ns
        period_ns = started_ns - self._cycle_started_ns if self.cycles else 0
        status = self._status
        status.stamp[0] = self._state.stamp[0]
        status.put_scalars(self.cycles, period_ns, 0, step_ns, 0, sequence, self._horizon_ns)
        self._link.publish(topics.CONTROL_STATUS, status.payload())
        self._cycle_started_ns = started_ns
        self.cycles += 1
        if self.mode is Mode.READY:
            self._change_mode(Cue.COMMAND, "first torque sent")
        if self._task.guard.hits:
            self._note_hits(self._task.guard)
        if self._to_announce:
            self._announce()

    def _note_hits(self, guard: TorqueGuard) -> None:
        new = guard.counts.note(guard.hits)
        if new:
            detail = f"reached for the first time: {name_of(new)}"
            self._to_announce.append((EventKind.LIMIT, detail))

    def _change_mode(self, cue: Cue, why: str) -> None:
        self.mode = follow(self.mode, cue)
        self._to_announce.append((EventKind.MODE, mode_event(self.mode, why)))

    def _announce(self) -> None:
        """Send what there is to tell; the torque is already on its way."""
        told, self._to_announce = self._to_announce, []
        for kind, detail in told:
            event = RunEvent(max(self.stamp_ns, 0), Role.CONTROLLER, kind, detail)
            self._link.publish(topics.RUN_EVENTS, event.encode())

    def _heed(self, plant_status: bytes | None, stamp_ns: int) -> int:
        """Take in what the plant says of the command in force; when it says the run began.

        For a foreign plant, which says nothing, the run begins with its first state.
        """
        start_ns, self._echo = stamp_ns, None
        if plant_status is not None:
            try:
                self._plant_status_layout.decode(plant_status, self._plant_status)
            except InvalidMessageError as error:
                self.rejections.note(error)
            else:
                fields = self._plant_status.fields
                start_ns = int(fields["start.sec"][0]) * 1_000_000_000
                start_ns += int(fields["start.nanosec"][0])
                self._echo = Echo(
                    int(fields["command_sequence"][0]), int(fields["command_delay_ns"][0])
                )
        return start_ns

    def _tracking_in_status(self) -> Tracking:
        """The tracking situation and the law's diagnostics, laid into the messages they go by."""
        tracking, diagnostics = Tracking(self._task.robot.joints), self._task.law.diagnostics
        tracking.position = self._state.fields["position"]
        tracking.velocity = self._state.fields["velocity"]
        for name in (
            "reference_position", "reference_velocity", "error", "error_rate",
            "upper_bound", "lower_bound",
        ):  # fmt: skip
            setattr(tracking, name, self._status.fields[name])
        for name, values in vars(diagnostics).items():
            self._status.fields[name][:] = values
            setattr(diagnostics, name, self._status.fields[name])
        foresight = [
            self._status.fields[name]
            for name in ("foreseen_error", "learned_disturbance", "learned_friction")
        ]
        for values in foresight:
            values[:] = np.nan
        if self._compensation is not None:
            self._compensation.report_into(*foresight)
        return tracking


def reason_of(error: Exception) -> str:
    """What stopped a controller, in one sentence; a stranger's exception is told by its name."""
    return str(error) if isinstance(error, ControllerError) else f"{type(error).__name__}: {error}"
