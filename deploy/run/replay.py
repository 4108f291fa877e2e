"""Replay: feed a recorded run's states to the law again, and compare torques bit for bit."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InvalidMessageError
from bus_schema.link.in_process import InProcessBus, InProcessControllerLink
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.recording.mcap_log import LogContents
from bus_schema.runtime.clock import VirtualClock
from controller.control_loop import ControlLoop
from controller.policies.served_law import ServedLaw
from deploy.judge.run_data import digest
from deploy.run.recording import RUN_METADATA
from deploy.scenario.setup import Setup
from plant_emulator.faults.process_faults import process_faults

_STAMP = slice(4, 12)


@dataclass(frozen=True)
class Replay:
    """Comparison of a replay with its recording.

    Attributes:
        recorded: commands in the recording.
        replayed: commands of the replay.
        first_difference: index of the first command that differs; None if none does.
        digest: digest of the replay.
        recorded_digest: digest of the recording.
        failure: what ended the replay before all recorded states were answered; empty if nothing
            did.
    """

    recorded: int
    replayed: int
    first_difference: int | None
    digest: str
    recorded_digest: str
    failure: str = ""

    @property
    def is_identical(self) -> bool:
        return self.first_difference is None and self.digest == self.recorded_digest


def replay(setup: Setup, contents: LogContents) -> Replay:
    """Feed the recorded joint states to a new law.

    Args:
        setup: the recorded scenario.
        contents: the recording; if it is partial, or a fault hit the controller, it is compared as
            far as it goes.
    """
    states = contents.payloads[topics.JOINT_STATES.name]
    recorded = contents.payloads[topics.JOINT_COMMANDS.name]
    bus = InProcessBus(VirtualClock())
    link, answered, missing = InProcessControllerLink(bus), states, ""
    # The law may have missed states, as a master of drives does in real time.
    clock = contents.metadata.get(RUN_METADATA, {}).get("clock")
    master_skips = setup.link_kind.controller_leads and clock == "realtime"
    if master_skips:
        link.start_ns = 0
        answered, missing = _states_answered(setup, contents)
    task = setup.control_task()
    if isinstance(task.law, ServedLaw):
        task.law.answer_from(_served_answers(contents))
    loop = ControlLoop(task, link)
    loop.warm_up()
    has_status = setup.link_kind.brings_plant_status
    statuses = _statuses_beside(contents) if has_status else [None] * len(answered)
    failure = _cycle_through(loop, answered, statuses) or missing
    replayed = [command.payload for command in bus.commands]
    rounding = setup.link_kind.wire_rounding(setup.link_run(lockstep=True))
    if rounding is not None:
        replayed = _as_delivered(setup, replayed, rounding)
    if master_skips:  # a command is recorded with the stamp of the drives' state before it
        beside = zip(replayed, recorded, strict=False)
        replayed = [
            *(new[: _STAMP.start] + old[_STAMP] + new[_STAMP.stop :] for new, old in beside),
            *replayed[len(recorded) :],
        ]
    if missing:
        return _not_comparable(len(recorded), len(answered), missing)
    if len(replayed) == len(recorded) + 1 and _answered_states(contents) == len(recorded):
        replayed = replayed[:-1]  # the run ended between the last state and its answer
    if not contents.complete or process_faults(setup.scenario.faults):
        whole = min(len(recorded), len(replayed))
        recorded, replayed = recorded[:whole], replayed[:whole]
    pairs = zip_longest(recorded, replayed)
    differing = (index for index, (a, b) in enumerate(pairs) if a != b)
    return Replay(
        recorded=len(recorded),
        replayed=len(replayed),
        first_difference=next(differing, None),
        digest=digest(states, replayed),
        recorded_digest=digest(states, recorded),
        failure=failure,
    )


def _not_comparable(recorded: int, answered: int, missing: str) -> Replay:
    """A replay that ended at a command whose state is not in the recording."""
    return Replay(recorded, answered, first_difference=answered, digest="", recorded_digest="",
                  failure=missing)  # fmt: skip


def _answered_states(contents: LogContents) -> int | None:
    """Return how many states the controller answered, by its own count; None without one."""
    for payload in reversed(contents.payloads[topics.RUN_EVENTS.name]):
        with contextlib.suppress(InvalidMessageError, ValueError, KeyError, TypeError):
            event = RunEvent.decode(payload)
            if (event.source, event.kind) == (Role.CONTROLLER, EventKind.ENDED):
                counts = event.values()
                return int(counts["cycles"]) + int(counts["late"])
    return None


def _served_answers(contents: LogContents) -> list[dict[str, Any]]:
    """Return the answers of a policy server, for `ServedLaw.answer_from`."""
    answers = []
    for payload in contents.payloads[topics.RUN_EVENTS.name]:
        with contextlib.suppress(InvalidMessageError):
            event = RunEvent.decode(payload)
            if (event.source, event.kind) == (Role.CONTROLLER, EventKind.ANSWER):
                answers.append(event.values())
    return answers


def _states_answered(setup: Setup, contents: LogContents) -> tuple[list[bytes], str]:
    """Return the states that the law answered, with the stamps that their master gave them.

    In real time a master skips states that come too late, and stamps by its own ticks. Each
    control status has the stamp and the errors of the state that was answered.

    Returns:
        The states, and which one was not found; empty if all were.
    """
    names = setup.robot.joint_names
    layouts = [topics.layout(each, names) for each in (topics.JOINT_STATES, topics.CONTROL_STATUS)]
    (state_layout, status_layout), (state, status) = layouts, map(Record, layouts)
    payloads, answered = iter(contents.payloads[topics.JOINT_STATES.name]), []
    for message in contents.payloads[topics.CONTROL_STATUS.name]:
        stamp_ns = status_layout.decode(message, status)
        for payload in payloads:
            state_layout.decode(payload, state)
            if _is_answer(status, state):
                answered.append(payload[: _STAMP.start] + message[_STAMP] + payload[_STAMP.stop :])
                break
        else:
            return answered, f"no recorded state is the one answered at {1e-9 * stamp_ns:.3f} s"
    return answered, ""


def _is_answer(status: Record, state: Record) -> bool:
    """Return whether a control status has the errors of a state, bit for bit."""
    reported, seen = status.fields, state.fields
    return np.array_equal(
        seen["position"] - reported["reference_position"], reported["error"]
    ) and np.array_equal(seen["velocity"] - reported["reference_velocity"], reported["error_rate"])


def _statuses_beside(contents: LogContents) -> list[bytes | None]:
    """Return the plant status that was sent with each joint state; None where there was none.

    Both have the same stamp and the same number, which distinguishes the plant's from a repetition
    by another sender. A plant with other numbers sends one status for each stamp.
    """
    name = topics.PLANT_STATUS.name
    of_number: dict[tuple[int, bytes], bytes] = {}
    of_stamp: dict[bytes, bytes] = {}
    for number, status in zip(contents.sequences[name], contents.payloads[name], strict=True):
        of_number.setdefault((number, status[_STAMP]), status)
        of_stamp.setdefault(status[_STAMP], status)
    name = topics.JOINT_STATES.name
    return [
        of_number.get((number, state[_STAMP]), of_stamp.get(state[_STAMP]))
        for number, state in zip(contents.sequences[name], contents.payloads[name], strict=True)
    ]


def _cycle_through(
    loop: ControlLoop, states: Sequence[bytes], statuses: Sequence[bytes | None]
) -> str:
    """Answer all states; return what ended that early, for instance a law that failed again."""
    for state, status in zip(states, statuses, strict=True):
        try:
            loop.cycle(state, status)
        except Exception as error:  # noqa: BLE001 (a user's law may raise any exception)
            return str(error)
    return ""


def _as_delivered(
    setup: Setup, commands: list[bytes], rounding: Callable[[Vector], Vector]
) -> list[bytes]:
    """Round commands as a link does that rounds torques."""
    layout = topics.layout(topics.JOINT_COMMANDS, setup.robot.joint_names)
    command, delivered = Record(layout), []
    for payload in commands:
        layout.decode(payload, command)
        command.fields["effort"][:] = rounding(command.fields["effort"])
        delivered.append(command.payload())
    return delivered
