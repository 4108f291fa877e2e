"""Counts of messages rejected on arrival: by reason, logged a few times, never fatal."""

from __future__ import annotations

import logging
from collections import Counter

from bus_schema.errors import InvalidMessageError

_LOGGED_PER_REASON = 5


class Rejections:
    """Counter of rejected messages; a flood of them fills counters, not logs.

    Attributes:
        counts: number of rejections by reason.
    """

    def __init__(self, what: str, logger: logging.Logger) -> None:
        self._what = what
        self._logger = logger
        self.counts: Counter[str] = Counter()

    def note(self, error: InvalidMessageError) -> None:
        """Count a rejection."""
        self.counts[error.reason] += 1
        if self.counts[error.reason] <= _LOGGED_PER_REASON:
            self._logger.warning("%s ignored: %s", self._what, error)
