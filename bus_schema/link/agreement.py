"""Digests of the values that both sides of a link must agree on, short enough to announce."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

_DIGITS = 8


class Agreement:
    """Digests of values that must be the same on both sides.

    Args:
        values: text of each value, by the key under which a difference is reported.
        run_key: random text with which the sessions of the run's recorders begin; empty if its
            processes were started one by one.
    """

    def __init__(self, values: Mapping[str, str], run_key: str = "") -> None:
        self.run_key = run_key
        self._digests = {key: _digest(key, value) for key, value in values.items()}

    def encode(self) -> str:
        """Encode all digests in letters and digits."""
        return "".join(sorted(self._digests.values()))

    def differences(self, theirs: str) -> list[str]:
        """Return the keys whose values differ from the other side's; empty if none.

        Args:
            theirs: the other side's encoded digests; any other text does not agree.
        """
        known = {theirs[start : start + _DIGITS] for start in range(0, len(theirs), _DIGITS)}
        own = set(self._digests.values())
        differing = [key for key, digest in self._digests.items() if digest not in known]
        if not differing and known - own:
            return ["keys that only the other process has"]
        return differing


def _digest(key: str, value: str) -> str:
    return hashlib.sha256(f"{key}={value}".encode()).hexdigest()[:_DIGITS]
