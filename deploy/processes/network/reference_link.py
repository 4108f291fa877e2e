"""The plant's link with the reference beside every state, for controllers that do not know it."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus_schema.link.interface import PlantLink
from bus_schema.messages import topics
from bus_schema.messages.header import stamp_of
from bus_schema.messages.layout import Record
from controller.reference import Reference


class ReferenceLink:
    """A `PlantLink` that sends `joint_reference` before each state, and else is what it wraps.

    It has the stamp of the state: where the joints are to be, and how fast, when they are measured.

    Args:
        link: the plant's side of a bus.
        reference: of the run.
        joint_names: names of the joints.
    """

    def __init__(self, link: PlantLink, reference: Reference, joint_names: tuple[str, ...]) -> None:
        self._link = link
        self._record = Record(topics.layout(topics.JOINT_REFERENCE, joint_names))
        motion = self._record.rows("position", "velocity")
        self._follow = reference.onto(motion[0], motion[1], np.empty(len(joint_names)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def send_state(self, state: bytes, status: bytes) -> None:
        """Send a joint state, and what it should have been before it."""
        stamp_ns = stamp_of(state)
        if stamp_ns is not None:
            self._record.stamp_ns = stamp_ns
            self._follow(stamp_ns * 1e-9)
            self._link.publish(topics.JOINT_REFERENCE, self._record.payload())
        self._link.send_state(state, status)
