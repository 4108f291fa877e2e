"""The data of one run, from a recording or straight from memory, as tables."""

from __future__ import annotations

import contextlib
import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InvalidMessageError
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.messages.types import stamp_of, stamps_ns
from controller.reference import sample_motion
from deploy.judge.command_rows import tabulate_by_tick
from deploy.judge.reported_values import ReportedValues, reported_values
from deploy.scenario.setup import Setup

FORGED_STATE = "forged_state"
"""Key in `RunData.rejected`: commands of our own controller that answer no state of the plant."""
ROBOT_SERVER = "robot_server"
"""The link of a robot that answers its vendor's client."""
CLIENT = "the robot's client"
"""Shown instead of the law for such a client."""
FOREIGN = "a foreign controller"
"""Shown instead of the law for an unknown controller."""

Table = NDArray[np.void]
"""Messages of one topic, one row each; fields by dotted name (``header.stamp.sec``)."""


@dataclass(frozen=True)
class RunData:
    """One run.

    Attributes:
        setup: its scenario.
        clock: ``realtime``, ``lockstep`` or ``virtual`` (in one process).
        link: kind of link, or `ROBOT_SERVER`.
        tables: messages by topic name; every fixed-size topic has one, perhaps without rows.
        events: run events, by their time; those of one instant in order of arrival.
        digest: SHA-256 over the delivered joint states and the commands, in order.
        messages: number of recorded messages.
        lost: messages that the recorder knows it missed, by topic; None if they were not counted to
            the end.
        complete: the recording was finished properly, and is undamaged.
        damage: what is damaged, one sentence per problem.
        failures: failures of the run's processes, causes before consequences, a sentence each.
        lacks_checksums: no checksum covers all of its data, as in recordings of older versions.
        rejected: number of messages that the recorder rejected, by reason.
    """

    setup: Setup
    clock: str
    link: str
    tables: Mapping[str, Table]
    events: Sequence[RunEvent]
    digest: str
    messages: int
    lost: Mapping[str, int] | None = field(default_factory=dict)
    complete: bool = True
    damage: Sequence[str] = ()
    failures: Sequence[str] = ()
    lacks_checksums: bool = False
    rejected: Mapping[str, int] = field(default_factory=dict)

    @property
    def controller(self) -> str:
        """Name of the controller: a law's, or a process's; an unknown one sends only commands."""
        if self.link == ROBOT_SERVER:
            return CLIENT
        controller = self.setup.scenario.controller
        has_told = len(self.tables[topics.CONTROL_STATUS.name]) or any(
            event.source == Role.CONTROLLER for event in self.events
        )
        has_commanded = len(self.tables[topics.JOINT_COMMANDS.name]) > 0
        is_ours = bool(has_told) or not has_commanded or self.link != "zenoh"
        return controller.name if is_ours or controller.process is not None else FOREIGN

    def times_s(self, topic: Topic) -> Vector:
        """Return the stamps of a topic's messages, shape (messages,)."""
        return stamps_s(self.tables[topic.name])

    @cached_property
    def true_errors_rad(self) -> Matrix:
        """True joint errors at every tick, shape (ticks, joints)."""
        truth = self.tables[topics.PLANT_TRUTH.name]
        return np.asarray(truth["position"] - self._wanted[0])

    @property
    def reference_velocities_rad_s(self) -> Matrix:
        """The reference's velocities at every tick, shape (ticks, joints)."""
        return np.asarray(self._wanted[1])

    @cached_property
    def _wanted(self) -> Any:
        times_s = self.times_s(topics.PLANT_TRUTH)
        return sample_motion(self.setup.reference, times_s, self.setup.robot.joints)

    @property
    def motion(self) -> str:
        """SHA-256 over true positions, velocities and torques: equal for equal motions."""
        truth = self.tables[topics.PLANT_TRUTH.name]
        parts = (truth[name].tobytes() for name in ("position", "velocity", "torque"))
        return hashlib.sha256(b"".join(parts)).hexdigest()

    @cached_property
    def _reported(self) -> tuple[ReportedValues, list[str]]:
        return reported_values(self.events)

    @property
    def notes(self) -> list[str]:
        """Notes on ignored values in the processes' final reports, a sentence each."""
        return self._reported[1]

    def last_values(self, role: Role, kind: EventKind) -> dict[str, Any]:
        """Return the last usable values of a process's events of one kind.

        {} without one; see `reported_values`.
        """
        return self._reported[0].get((role, kind), {})

    def faults(self) -> list[str]:
        """All faults, a sentence each, causes before consequences."""
        return [*self.failures] + [
            f"{event.source} at {event.stamp_ns * 1e-9:.3f} s: {event.detail}"
            for event in self.events
            if event.kind == EventKind.FAULT
        ]


def stamps_s(table: Table) -> Vector:
    """Return header stamps in seconds."""
    return table["header.stamp.sec"] + 1e-9 * table["header.stamp.nanosec"]


def digest(states: Sequence[bytes], commands: Sequence[bytes]) -> str:
    """Return SHA-256 over delivered joint states, then commands, each in order, as wire bytes.

    The first state may have been sent, and answered, several times; repetitions do not belong to
    the run and are ignored.
    """
    hasher = hashlib.sha256()
    for payloads in (states, commands):
        repetitions = sum(1 for _ in takewhile(payloads[0].__eq__, payloads[1:])) if payloads else 0
        hasher.update(b"".join(payloads[repetitions:]))
    return hasher.hexdigest()


def build_run_data(
    setup: Setup,
    payloads: Mapping[str, Sequence[bytes]],
    *,
    clock: str,
    link: str,
    **of_recording: Any,
) -> RunData:
    """Return the data of a run from its messages by topic name; unusable messages are left out.

    Args:
        setup: the scenario.
        payloads: the messages.
        clock: as `RunData` has it.
        link: likewise.
        of_recording: its other fields about the recording: ``lost``, ``complete`` and so on.
    """
    states, commands = (
        payloads.get(topic.name, ()) for topic in (topics.JOINT_STATES, topics.JOINT_COMMANDS)
    )
    layouts = setup.layouts()
    tables = {name: each.tabulate(payloads.get(name, ())) for name, each in layouts.items()}
    truth = tables[topics.PLANT_TRUTH.name]
    tables[topics.PLANT_TRUTH.name], repeated = _in_order(truth)
    damage = [*of_recording.pop("damage", ())]
    if repeated:
        repetition = (
            f"{repeated} of {len(truth)} messages of the true motion repeat a time or go back"
        )
        damage.append(repetition)
    events = [*_events(payloads.get(topics.RUN_EVENTS.name, ()))]
    has_all_states = not (of_recording.get("lost") or {}).get(topics.JOINT_STATES.name)
    if link == "zenoh" and has_all_states and (forged := _forged_states(payloads, events)):
        of_recording["rejected"] = {**of_recording.get("rejected", {}), FORGED_STATE: forged}
        damage.append(f"another sender sent states to the controller ({FORGED_STATE}: {forged})")
    if setup.answer_every > 1:
        name, truth = topics.JOINT_COMMANDS.name, tables[topics.PLANT_TRUTH.name]
        end_ns = int(stamps_ns(truth)[-1]) if len(truth) else -1
        tables[name] = tabulate_by_tick(layouts[name], commands, setup.grid.period_ns, end_ns)
    return RunData(
        setup=setup,
        clock=clock,
        link=link,
        tables=tables,
        events=sorted(events, key=lambda event: event.stamp_ns),
        digest=digest(states, commands),
        messages=sum(len(messages) for messages in payloads.values()),
        damage=damage,
        **of_recording,
    )


def _forged_states(payloads: Mapping[str, Sequence[bytes]], events: Sequence[RunEvent]) -> int:
    """Count commands of our own controller that answer no recorded state, or one again.

    It answers each state that it receives once, under the state's stamp. Controllers of others,
    which send no control status, may stamp as they like, and two may answer the same state.
    """
    commanders = sum(event.kind == EventKind.COMMANDER for event in events)
    if commanders != 1 or not payloads.get(topics.CONTROL_STATUS.name):
        return 0
    states = Counter(map(stamp_of, payloads.get(topics.JOINT_STATES.name, ())))
    commands = Counter(map(stamp_of, payloads.get(topics.JOINT_COMMANDS.name, ())))
    del commands[None]  # of those that are malformed
    return (commands - states).total()


def _in_order(table: Table) -> tuple[Table, int]:
    """Return a topic's messages by rising stamp, one of each, and how many were out of order."""
    steps = np.diff(stamps_ns(table))
    if (steps > 0).all():  # in all but a damaged recording
        return table, 0
    return table[np.unique(stamps_ns(table), return_index=True)[1]], int((steps <= 0).sum())


def _events(payloads: Sequence[bytes]) -> Iterator[RunEvent]:
    for payload in payloads:
        with contextlib.suppress(InvalidMessageError):
            yield RunEvent.decode(payload)
