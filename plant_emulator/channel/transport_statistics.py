"""What became of the messages of one direction."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bus_schema.percentiles import percentiles


@dataclass
class TransportStatistics:
    """Counts of one direction.

    Attributes:
        sent: messages handed to the channel.
        delivered: messages that came out of it, copies included.
        lost: messages that never come out.
        duplicated: copies that came out.
        reordered: messages that came out behind a younger one.
        loss_bursts: unbroken runs of lost messages.
        longest_loss_burst: messages in the longest of them.
        delays_us: number of deliveries by delay, in whole µs.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0
    loss_bursts: int = 0
    longest_loss_burst: int = 0
    delays_us: Counter[int] = field(default_factory=Counter)
    _burst: int = 0
    _newest: int = -1

    def note_sent(self, *, is_lost: bool) -> None:
        """Count a message that was handed to the channel."""
        self.sent += 1
        if not is_lost:
            self._burst = 0
            return
        self.lost += 1
        self.loss_bursts += self._burst == 0
        self._burst += 1
        self.longest_loss_burst = max(self.longest_loss_burst, self._burst)

    def note_delivered(self, delay_ns: int, number: int, *, is_copy: bool) -> None:
        """Count a message that came out.

        Args:
            delay_ns: time from entering the channel to coming out of it.
            number: of the message, in the order of sending.
            is_copy: whether it is the second one of its number.
        """
        self.delivered += 1
        self.delays_us[(delay_ns + 500) // 1000] += 1
        if is_copy:
            self.duplicated += 1
        elif number < self._newest:
            self.reordered += 1
        self._newest = max(self._newest, number)

    def summary(self) -> dict[str, Any]:
        """The section of ``summary.json`` on this direction; null where there is nothing.

        ``delay_ms`` is the time from entering the channel to coming out of it.
        """
        mean_burst = self.lost / self.loss_bursts if self.loss_bursts else None
        counts = ("sent", "delivered", "lost", "duplicated", "reordered")
        return {
            **{name: getattr(self, name) for name in counts},
            "delay_ms": self._delay_ms(),
            "loss_burst": {"mean": mean_burst, "longest": self.longest_loss_burst},
        }

    def _delay_ms(self) -> dict[str, float | None]:
        delays_us = np.array(list(self.delays_us))
        counts = np.array(list(self.delays_us.values()))
        mean = float(delays_us @ counts) / self.delivered / 1000 if self.delivered else None
        return {"mean": mean, **percentiles(delays_us / 1000, counts)}
