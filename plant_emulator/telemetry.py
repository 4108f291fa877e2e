"""The plant's telemetry: true motion and timing at every tick, and events.

Entries are collected, and sent when the loop has time: after it has sent a state.
"""

from __future__ import annotations

import time

from bus_schema.link.interface import PlantLink
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.runtime.compiled import copying
from plant_emulator.arm_plant import ArmPlant

_NO_CYCLE_NS = -1


class PlantTelemetry:
    """Collects and sends the plant's telemetry.

    Args:
        joint_names: names of the joints.
        arm: the arm.
        deadline_ns: largest age of the state that the command in force answers.
        announced_for_ns: a command that says when it acts may be in force for so long after that,
            if that is longer; None if `deadline_ns` applies to all commands.

    Attributes:
        late_ticks: ticks at which the command in force was too old, or that were skipped.
        skipped: ticks skipped so far because the loop was late; nothing is measured there.
        physics_ns: time of the physics since the last cycle, outside of one.
        state_age_ns: age of the state that was delivered since the last tick; -1 for none.
        round_trip_ns: time from a state to the command that answered it since then; -1 for none.
    """

    def __init__(
        self,
        joint_names: tuple[str, ...],
        arm: ArmPlant,
        deadline_ns: int,
        announced_for_ns: int | None = None,
    ) -> None:
        self._deadline_ns = self._allowed_age_ns = deadline_ns
        self._announced_for_ns = announced_for_ns
        self._truth = Record(topics.layout(topics.PLANT_TRUTH, joint_names))
        self._arm = arm
        # Views take a third of the time of NumPy's copies, at every tick.
        self._take_motion = copying(arm.motion, self._truth.rows("position", "velocity"))
        self._take_torques = copying(
            arm.torques.acting, self._truth.rows("torque", "friction", "disturbance")
        )
        self._entries: list[tuple[topics.Topic, bytes]] = []
        self._cycle_started_ns = 0
        self._period_ns = 0
        self._lateness_ns = 0
        self._step_ns = 0
        self.round_trip_ns = -1
        self.state_age_ns = -1
        self.skipped = 0
        self.physics_ns = 0
        self.late_ticks = 0

    def begin_cycle(self, lateness_ns: int) -> None:
        """Begin a cycle, this late after its planned instant."""
        now_ns = time.perf_counter_ns()
        self._period_ns = now_ns - self._cycle_started_ns if self._cycle_started_ns else 0
        self._lateness_ns = lateness_ns
        self._cycle_started_ns = now_ns

    def end_cycle(self) -> None:
        """End the work of a cycle."""
        self._step_ns = self.physics_ns + time.perf_counter_ns() - self._cycle_started_ns
        self.physics_ns = 0

    def allow(self, acts_after_ns: int) -> None:
        """Allow a command the time that it says it needs until it acts; 0 if it says nothing."""
        if acts_after_ns and self._announced_for_ns is not None:
            announced_ns = acts_after_ns + self._announced_for_ns
            self._allowed_age_ns = max(self._deadline_ns, announced_ns)

    def note_truth(
        self,
        stamp_ns: int,
        tick: int,
        command_sequence: int,
        command_age_ns: int,
        *,
        was_skipped: bool,
    ) -> None:
        """Note the true motion at a tick, also at a skipped one.

        Args:
            stamp_ns: instant of the tick.
            tick: its number.
            command_sequence: number of the command in force, 0 before the first.
            command_age_ns: age of the state it answers, -1 before the first.
            was_skipped: the loop was too late to measure at this tick.
        """
        # Before the first command, the age cannot exceed the run's own.
        age_ns = command_age_ns if command_age_ns >= 0 else stamp_ns
        is_in_time = age_ns <= self._allowed_age_ns
        self.late_ticks += was_skipped or not is_in_time
        truth = self._truth
        truth.stamp_ns = stamp_ns
        scalars = truth.scalars
        scalars.timing_cycle = tick
        scalars.timing_period_ns = self._period_ns
        scalars.timing_lateness_ns = _NO_CYCLE_NS if was_skipped else self._lateness_ns
        scalars.timing_step_ns = self._step_ns
        scalars.timing_skipped = self.skipped
        scalars.command_sequence = command_sequence
        scalars.command_age_ns = command_age_ns
        scalars.round_trip_ns = self.round_trip_ns
        scalars.state_age_ns = self.state_age_ns
        scalars.mode = self._arm.mode
        scalars.deadline_met = is_in_time
        scalars.saturated = self._arm.torques.saturated
        self._take_motion()
        self._take_torques()
        self._entries.append((topics.PLANT_TRUTH, truth.payload()))
        self.round_trip_ns = self.state_age_ns = -1

    def note_event(self, stamp_ns: int, kind: EventKind, detail: str) -> None:
        """Note an event."""
        event = RunEvent(stamp_ns, Role.PLANT, kind, detail)
        self._entries.append((topics.RUN_EVENTS, event.encode()))

    def send(self, link: PlantLink) -> None:
        """Send all notes."""
        if not self._entries:
            return
        for topic, payload in self._entries:
            link.publish(topic, payload)
        self._entries.clear()
