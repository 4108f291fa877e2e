"""The plant's link with another message before every state: the run's clock, or the reference.

The clock is for nodes with ``use_sim_time``, the reference for controllers that do not know it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np

from bus_schema.link.interface import PlantLink
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.types import ENCAPSULATION_BYTES, stamp_of
from controller.reference import Reference

_CLOCK_BYTES = ENCAPSULATION_BYTES + 8


class _LinkWithTopic:
    """A `PlantLink` that sends another message before each state, and wraps the real link."""

    def __init__(self, link: PlantLink, send: Callable[[bytes, int], None]) -> None:
        self._link, self._send = link, send

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def send_state(self, state: bytes, status: bytes) -> None:
        stamp_ns = stamp_of(state)
        if stamp_ns is not None:
            self._send(state, stamp_ns)
        self._link.send_state(state, status)


def with_clock(link: PlantLink) -> PlantLink:
    """Return the link, extended to send `clock` before each state: its stamp, copied as bytes.

    A node that stamps commands with its time then uses the stamp of the newest state.
    """

    def send(state: bytes, _stamp_ns: int) -> None:
        link.publish(topics.CLOCK, state[:_CLOCK_BYTES])

    return cast("PlantLink", _LinkWithTopic(link, send))


def with_reference(
    link: PlantLink, reference: Reference, joint_names: tuple[str, ...]
) -> PlantLink:
    """Return the link, extended to send `joint_reference` before each state, with its stamp.

    It contains the joints' reference positions and velocities at the time of measurement.
    """
    record = Record(topics.layout(topics.JOINT_REFERENCE, joint_names))
    motion = record.rows("position", "velocity")
    follow = reference.onto(motion[0], motion[1], np.empty(len(joint_names)))

    def send(_state: bytes, stamp_ns: int) -> None:
        record.stamp_ns = stamp_ns
        follow(stamp_ns * 1e-9)
        link.publish(topics.JOINT_REFERENCE, record.payload())

    return cast("PlantLink", _LinkWithTopic(link, send))
