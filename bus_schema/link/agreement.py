"""What both sides of a link must agree on, in a form that is short enough to announce."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

_DIGITS = 8


class Agreement:
    """Digests of values that must be the same on both sides.

    Args:
        values: text of each value, by the key under which a difference is told.
    """

    def __init__(self, values: Mapping[str, str]) -> None:
        self._digests = {key: _digest(key, value) for key, value in values.items()}

    def encode(self) -> str:
        """All digests, in letters and figures alone."""
        return "".join(sorted(self._digests.values()))

    def differences(self, theirs: str) -> list[str]:
        """Keys whose values are not those that another side announced; empty if it agrees.

        Args:
            theirs: what the other side encoded; whatever else it may be, it does not agree.
        """
        known = {theirs[start : start + _DIGITS] for start in range(0, len(theirs), _DIGITS)}
        own = set(self._digests.values())
        differing = [key for key, digest in self._digests.items() if digest not in known]
        if not differing and known - own:
            return ["keys that only the other side has"]
        return differing


def _digest(key: str, value: str) -> str:
    return hashlib.sha256(f"{key}={value}".encode()).hexdigest()[:_DIGITS]
