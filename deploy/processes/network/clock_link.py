"""The plant's link with the run's clock beside every state, for nodes with ``use_sim_time``."""

from __future__ import annotations

from typing import Any

from bus_schema.link.interface import PlantLink
from bus_schema.messages.header import ENCAPSULATION_BYTES, stamp_of
from bus_schema.messages.topics import CLOCK

_CLOCK_BYTES = ENCAPSULATION_BYTES + 8


class ClockLink:
    """A `PlantLink` that sends `clock` before each state, and else is what it wraps.

    Who stamps commands with the time then stamps them with that of the newest state.

    Args:
        link: the plant's side of a bus.
    """

    def __init__(self, link: PlantLink) -> None:
        self._link = link

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def send_state(self, state: bytes, status: bytes) -> None:
        """Send a joint state, and before it its stamp, with which its bytes begin."""
        if stamp_of(state) is not None:
            self._link.publish(CLOCK, state[:_CLOCK_BYTES])
        self._link.send_state(state, status)
