"""The recording of a robot that answers its vendor's client: a run like others.

The positions that the client asks for become the reference of the run, so that the judge of all
runs says how far the arm is behind them.
"""

from __future__ import annotations

import json
import logging
import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.runtime.clock import own_kernel
from deploy.judge.run_data import ROBOT_SERVER
from deploy.run.network.live_feed import LiveFeed
from deploy.run.network.snapshot import Message
from deploy.run.recording import LoggedView, attach_scenario, close_log, open_log
from deploy.run.run_folder import RunFolder
from deploy.scenario.setup import Setup
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.telemetry import PlantTelemetry

logger = logging.getLogger(__name__)

_SEND_TICKS = 20
_NO_DEADLINE_NS = 1 << 62


class ServedRun:
    """Records what the arm does and what its client asks for.

    Args:
        setup: the scenario.
        folder: of the run.
        arm: the arm.

    Raises:
        OSError: the recording cannot be begun.
    """

    def __init__(self, setup: Setup, folder: RunFolder, arm: ArmPlant) -> None:
        names, layouts = setup.robot.joint_names, setup.layouts()
        self._arm, self._period_ns = arm, setup.grid.period_ns
        self._log = open_log(setup, folder.log, clock="realtime", link=ROBOT_SERVER)
        self._view = LoggedView(self._log, setup.robot, sent_ns=time.time_ns())
        self._feed = _live_feed(setup, folder)
        self._telemetry = PlantTelemetry(names, arm, _NO_DEADLINE_NS)
        self._state = Record(layouts[topics.JOINT_STATES.name])
        self._command = Record(layouts[topics.JOINT_COMMANDS.name])
        self._sequences: Counter[str] = Counter()
        self._stamp_ns = 0
        self._asked: Vector | None = None
        self._targets = 0
        self._began_s = 0.0
        self.note(0, EventKind.STARTED, "a client moves the arm")

    def tick(self, number: int, target_rad: Vector, *, was_skipped: bool) -> None:
        """Record a tick.

        Args:
            number: of the tick.
            target_rad: positions that the client asks for, shape (joints,); NaN for none.
            was_skipped: no client was served at it.
        """
        now_ns = number * self._period_ns
        self._began_s = self._began_s or time.monotonic()
        self._note_target(now_ns, target_rad)
        self._telemetry.begin_cycle(0)
        self._telemetry.skipped += was_skipped
        self._telemetry.note_truth(
            now_ns, number, self._targets, 0 if self._targets else -1, was_skipped=was_skipped
        )
        self._telemetry.send(self)  # type: ignore[arg-type]  # only `publish` is needed
        state = self._state
        state.stamp_ns = now_ns
        state.fields["position"][:], state.fields["velocity"][:] = self._arm.measured
        payload = state.payload()
        self.publish(topics.JOINT_STATES, payload, now_ns)
        self._view.show(payload, now_ns, time.time_ns())
        if self._feed is not None and number % _SEND_TICKS == 0:
            self._feed.send()

    def note(self, now_ns: int, kind: EventKind, detail: str) -> None:
        """Record an event of the robot."""
        event = RunEvent(now_ns, Role.PLANT, kind, detail)
        self.publish(topics.RUN_EVENTS, event.encode(), now_ns)

    def publish(self, topic: Topic, payload: bytes, stamp_ns: int | None = None) -> int:
        """Write a message, and show it live; return its number."""
        self._sequences[topic.name] += 1
        number = self._sequences[topic.name]
        stamp_ns = self._stamp_ns if stamp_ns is None else stamp_ns
        self._log.write(topic, number, stamp_ns, time.time_ns(), payload)
        if self._feed is not None and self._feed.is_watched:
            self._feed.take(Message(topic, stamp_ns, payload))
        return number

    def close(self, judged: Setup, counts: Mapping[str, Any], **ended: Any) -> None:
        """Finish the recording.

        Args:
            judged: the scenario with the reference by which the run is judged.
            counts: counts of the robot and its network.
            ended: ``ticks`` and ``completed``.
        """
        now_ns = ended["ticks"] * self._period_ns
        self.note(now_ns, EventKind.COUNTS, json.dumps(counts))
        outcome = {
            **ended, "wall_s": time.monotonic() - self._began_s, "stolen_ms": 0.0,
            "physics": self._arm.physics, "kernel": own_kernel(),
        }  # fmt: skip
        self.note(now_ns, EventKind.ENDED, json.dumps(outcome))
        attach_scenario(self._log, judged)
        close_log(self._log, Counter(), Counter())
        if self._feed is not None:
            self._feed.send()
            self._feed.close()

    def _note_target(self, now_ns: int, target_rad: Vector) -> None:
        """Record what the client asks for, if that is new."""
        self._stamp_ns = now_ns
        if np.isnan(target_rad).any() or (
            self._asked is not None and np.array_equal(self._asked, target_rad)
        ):
            return
        self._asked, self._targets = target_rad.copy(), self._targets + 1
        self._command.stamp_ns = now_ns
        if self._command.fields["position"].size:
            self._command.fields["position"][:] = target_rad
        self.publish(topics.JOINT_COMMANDS, self._command.payload(), now_ns)


def _live_feed(setup: Setup, folder: RunFolder) -> LiveFeed | None:
    """Return the feed of live views; None if its socket cannot be created, which fails no run."""
    endpoint, scenario = setup.scenario.link.plant_endpoint, folder.scenario.resolve()
    try:
        return LiveFeed(endpoint, scenario, setup.robot.joint_names)
    except OSError as error:
        logger.warning("no live view: %s", error)
        return None
