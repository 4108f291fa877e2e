"""Frames: the values that a page shows of a run at one time, with the last minute of them."""

from __future__ import annotations

import math
import threading
from collections import deque
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.errors import InvalidMessageError
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.runtime.modes import Mode
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.reports.figures.space import skeletons
from deploy.run.network.snapshot import Snapshot
from deploy.scenario.setup import Setup

_KEPT = 1200
_MOST_EVENTS = 20
_TOLD = (EventKind.MODE, EventKind.FAULT, EventKind.INJECTED, EventKind.LIMIT, EventKind.COMMANDER)
_MRAD, _MS = 1e3, 1e-6

Frame = dict[str, Any]
"""One frame of a run, ready for JSON."""


class RunState:
    """The newest values of a run, from snapshots; unreadable messages are ignored.

    Args:
        setup: the scenario.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._layouts = setup.layouts()
        self._model = ManipulatorModel(setup.robot)
        self._newest: dict[str, Record] = {}
        self._events: deque[str] = deque(maxlen=_MOST_EVENTS)
        self._ticks = self._missed = 0

    def take(self, snapshot: Snapshot) -> None:
        """Take a message."""
        self._ticks, self._missed = snapshot.ticks, snapshot.deadlines_missed
        for topic, _, payload in snapshot.messages:
            try:
                if topic is topics.RUN_EVENTS:
                    self._tell(RunEvent.decode(payload))
                elif topic.name in self._layouts:
                    record = Record(self._layouts[topic.name])
                    self._layouts[topic.name].decode(payload, record)
                    self._newest[topic.name] = record
            except InvalidMessageError:
                continue

    def frame(self) -> Frame | None:
        """Return the newest frame; None before any joint state."""
        truth = self._newest.get(topics.PLANT_TRUTH.name)
        motion = truth or self._newest.get(topics.JOINT_STATES.name)
        if motion is None:
            return None
        time_s, position = motion.stamp_ns * 1e-9, motion.fields["position"]
        joints = self._setup.robot.joints
        reference = sample_positions(self._setup.reference, np.array([time_s]), joints)[0]
        upper, lower = self._setup.funnel.bounds(np.array([time_s]))
        return {
            "time_s": time_s,
            "error": _numbers(_MRAD * (position - reference)),
            "upper": _numbers(_MRAD * upper[0]),
            "lower": _numbers(_MRAD * lower[0]),
            "torque": _numbers(self._torque(joints)),
            "arm": self._skeleton(position),
            "reference_arm": self._skeleton(reference),
            "ticks": self._ticks,
            "missed": self._missed,
            "events": list(self._events),
            **self._timing(truth),
        }

    def _skeleton(self, position: Vector) -> dict[str, list[float | None]] | None:
        """Return the coordinates of the arm's line, m; None if a position is not finite."""
        if not np.isfinite(position).all():
            return None
        points = skeletons(self._model, position[np.newaxis])[0, :-1].round(5)
        return dict(zip("xyz", map(_numbers, points.T), strict=True))

    def _torque(self, joints: int) -> Vector:
        command, truth = (
            self._newest.get(topic.name) for topic in (topics.JOINT_COMMANDS, topics.PLANT_TRUTH)
        )
        if command is None:
            return np.full(joints, np.nan) if truth is None else truth.fields["torque"]
        has_target = np.isfinite(command.fields.get("position", np.nan)).any()
        if truth is not None and has_target:  # the drives add torques of their own
            return truth.fields["torque"]
        return command.fields["effort"]

    def _timing(self, truth: Record | None) -> Frame:
        if truth is None:
            return {"mode": None, "age_ms": None}
        age_ns, mode = truth.scalars.command_age_ns, truth.scalars.mode
        known = mode in {each.value for each in Mode}
        return {
            "mode": Mode(mode).name.lower() if known else None,
            "age_ms": None if age_ns < 0 else age_ns * _MS,
        }

    def _tell(self, event: RunEvent) -> None:
        if event.kind in _TOLD:
            entry = f"{event.stamp_ns * 1e-9:.3f} s  {event.source}: {event.detail}"
            self._events.append(entry[:300])


class Frames:
    """The last frames, for any number of waiting readers; a slow reader misses some."""

    def __init__(self) -> None:
        self._kept: deque[Frame] = deque(maxlen=_KEPT)
        self._number = 0
        self._changed = threading.Condition()
        self.is_over = False

    def add(self, frame: Frame) -> None:
        """Add a frame; if the run's clock went back, another run has begun."""
        with self._changed:
            if self._kept and frame["time_s"] < self._kept[-1]["time_s"]:
                self._kept.clear()
            self._kept.append(frame)
            self._number += 1
            self._changed.notify_all()

    def end(self) -> None:
        """Mark the end: no more frames follow."""
        with self._changed:
            self.is_over = True
            self._changed.notify_all()

    def after(self, number: int, timeout_s: float) -> tuple[int, list[Frame]]:
        """Return the frames after the `number`-th, as far as they are kept, and the new number."""
        with self._changed:
            self._changed.wait_for(lambda: self._number > number or self.is_over, timeout_s)
            fresh = min(self._number - number, len(self._kept))
            return self._number, list(self._kept)[len(self._kept) - fresh :]


def _numbers(values: Vector) -> list[float | None]:
    """Replace NaN, which JSON does not have."""
    return [value if math.isfinite(value) else None for value in values.tolist()]
