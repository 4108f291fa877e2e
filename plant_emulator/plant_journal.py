"""What the plant tells of itself: truth at every tick, timing of every cycle, events.

Entries are collected and sent when the loop has time for them: after a state is on its way.
"""

from __future__ import annotations

from bus_schema import topics
from bus_schema.cdr_layout import Record
from bus_schema.events import EventKind, RunEvent
from bus_schema.link import PlantLink
from bus_schema.topics import Role
from plant_emulator.arm_plant import ArmPlant


class PlantJournal:
    """Collects and sends the plant's telemetry.

    Attributes:
        round_trip_ns: round trip of the newest command since the last tick, -1 without one.
        state_age_ns: age of the newest state delivered since the last tick, -1 without one.
        lateness_ns: how late the loop woke up for this cycle.
        skipped: ticks at which nothing was measured, because the loop came too late.
        deadline_misses: ticks at which the command in force was too old.
    """

    def __init__(self, joint_names: tuple[str, ...], deadline_ns: int) -> None:
        self._deadline_ns = deadline_ns
        self._truth = Record(topics.layout(topics.PLANT_TRUTH, joint_names))
        self._timing = Record(topics.layout(topics.PLANT_TIMING, joint_names))
        self._entries: list[tuple[topics.Topic, bytes]] = []
        self._cycle_started_ns = 0
        self.round_trip_ns = -1
        self.state_age_ns = -1
        self.lateness_ns = 0
        self.skipped = 0
        self.deadline_misses = 0

    def note_truth(
        self, stamp_ns: int, arm: ArmPlant, command_sequence: int, command_age_ns: int
    ) -> None:
        """Note what is true at a tick, also at one that was skipped.

        Args:
            stamp_ns: instant of the tick.
            arm: the arm.
            command_sequence: number of the command in force, 0 before the first.
            command_age_ns: age of the state it answers, -1 before the first.
        """
        fields, torques = self._truth.fields, arm.torques
        # Before the first command nothing in force can be older than the run itself.
        age_ns = command_age_ns if command_age_ns >= 0 else stamp_ns
        is_in_time = age_ns <= self._deadline_ns
        self.deadline_misses += not is_in_time
        self._truth.stamp_ns = stamp_ns
        fields["mode"][0] = arm.mode
        fields["command_sequence"][0] = command_sequence
        fields["command_age_ns"][0] = command_age_ns
        fields["round_trip_ns"][0] = self.round_trip_ns
        fields["state_age_ns"][0] = self.state_age_ns
        fields["deadline_met"][0] = is_in_time
        fields["saturated"][0] = torques.saturated
        fields["position"][:] = arm.position
        fields["velocity"][:] = arm.velocity
        fields["torque"][:] = torques.actuator
        fields["friction"][:] = torques.friction
        fields["disturbance"][:] = torques.disturbance
        self._entries.append((topics.PLANT_TRUTH, self._truth.payload()))
        self.round_trip_ns = self.state_age_ns = -1

    def note_timing(self, stamp_ns: int, cycle: int, started_ns: int, done_ns: int) -> None:
        """Note how a cycle went; the last two are instants of a monotonic clock."""
        fields = self._timing.fields
        self._timing.stamp_ns = stamp_ns
        fields["cycle"][0] = cycle
        fields["period_ns"][0] = started_ns - self._cycle_started_ns if cycle > 1 else 0
        fields["lateness_ns"][0] = self.lateness_ns
        fields["step_ns"][0] = done_ns - started_ns
        fields["skipped"][0] = self.skipped
        self._entries.append((topics.PLANT_TIMING, self._timing.payload()))
        self._cycle_started_ns = started_ns

    def note_event(self, stamp_ns: int, kind: EventKind, detail: str) -> None:
        """Note that something happened."""
        event = RunEvent(stamp_ns, Role.PLANT, kind, detail)
        self._entries.append((topics.RUN_EVENTS, event.encode()))

    def send(self, link: PlantLink) -> None:
        """Send what was noted."""
        for topic, payload in self._entries:
            link.publish(topic, payload)
        self._entries.clear()
