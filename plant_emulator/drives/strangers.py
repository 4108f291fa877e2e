"""Detects other masters and drives on the bus, from the drives' side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanFrame

_MORE = 2
"""Frames more than there are ticks that say nothing yet: a cycle may begin before the tick does."""


class Strangers:
    """Counts frames of other masters and drives.

    Args:
        codec: the cyclic frames.
        node_ids: addresses of the drives.
        period_ns: of the cycle.
    """

    def __init__(self, codec: CanCodec, node_ids: Sequence[int], period_ns: int) -> None:
        self._codec, self._node_ids, self._period_ns = codec, tuple(node_ids), period_ns
        self._states, self._torques = [0] * len(node_ids), [0] * len(node_ids)
        self._scratch = np.zeros(len(node_ids)), np.zeros(len(node_ids))
        self._ticks = 0

    def note(self, frame: CanFrame, commanded: int | None, now_ns: int) -> None:
        """Note a frame that arrived from the bus at this time of the run.

        Args:
            frame: the frame.
            commanded: the joint whose torque it has; None if it has none.
            now_ns: the time.
        """
        self._ticks = max(self._ticks, now_ns // self._period_ns + 1)
        if commanded is not None:
            self._torques[commanded] += 1
        elif (joint := self._codec.read_state(frame, *self._scratch)) is not None:
            self._states[joint] += 1

    def in_words(self) -> str:
        """Describe what others sent; empty if nothing."""
        sentences = []
        for node_id, states, torques in zip(
            self._node_ids, self._states, self._torques, strict=True
        ):
            if states:
                sentences.append(
                    f"another drive on this bus has address {node_id} and sent {states} states"
                )
            if torques > self._ticks + _MORE:
                sentences.append(
                    f"another master is on this bus: drive {node_id} was sent {torques} commands"
                    f" in {self._ticks} cycles"
                )
        return "; ".join(sentences)
