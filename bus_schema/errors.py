"""Errors of the bus: one root, built-in bases where one fits."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

from bus_schema.foreign_text import in_one_line, shortened

_SHOWN_KEYS = 12
_LONGEST = 120
_LEAST_BEGINNING = 3
_LOGGED_PER_REASON = 5


class BusError(Exception):
    """Root of all errors of this package.

    Attributes:
        is_cause: other failures of the same run are consequences of this one.
        peer: role of the peer whose silence it is; empty for other errors.
    """

    is_cause = False
    peer = ""


class InvalidMessageError(BusError, ValueError):
    """A payload is not a valid message of the expected type.

    Attributes:
        reason: short identifier under which the rejection is counted.
    """

    def __init__(self, reason: str, explanation: str) -> None:
        super().__init__(explanation)
        self.reason = reason


class Rejections:
    """Counter of messages rejected on arrival; a flood of them fills counters, not logs.

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


class PeerSilentError(BusError, TimeoutError):
    """A peer did not answer in time.

    Attributes:
        peer: role of the peer (``controller``, ``plant`` or ``recorder``).
        waited_s: wall time waited for it.
    """

    def __init__(self, peer: str, waited_s: float, awaited: str) -> None:
        super().__init__(f"the {peer} is silent: no {awaited} within {waited_s:g} s")
        self.peer = peer
        self.waited_s = waited_s


class ScenarioMismatchError(BusError):
    """A peer runs another scenario; the message names the keys that differ.

    Attributes:
        keys: dotted keys.
    """

    def __init__(self, peer: str, keys: Sequence[str], *, may_be_forged: bool = False) -> None:
        shown = ", ".join(keys[:_SHOWN_KEYS])
        more = f" and {len(keys) - _SHOWN_KEYS} more" if len(keys) > _SHOWN_KEYS else ""
        forged = f"; or another program claims to be the {peer}: link.security prevents this"
        super().__init__(
            f"the {peer} runs another scenario; different keys: {shown}{more}: start both with the"
            f" same file and the same --set{forged if may_be_forged else ''}"
        )
        self.keys = list(keys)


class RobotDescriptionError(BusError, ValueError):
    """A URDF file cannot be used; the message names the file and what is wrong."""


class JointNameError(RobotDescriptionError):
    """The name of a joint to drive matches no joint that can be driven."""


def needs_extra(package: str, extra: str) -> str:
    """Say that a package is missing, and which extra of funnel-hil installs it."""
    return f"needs {package}: pip install 'funnel-hil[{extra}]'"


def did_you_mean(unknown: str, names: Iterable[str], alike: float = 0.6) -> str:
    """Return ``; did you mean …?`` if a name resembles an allowed one, or begins one; else nothing.

    Args:
        unknown: what was given.
        names: what is allowed.
        alike: similarity that is required, from 0 (any name) to 1 (the same name).
    """
    given, known = unknown[:_LONGEST].casefold(), {name.casefold(): name for name in names}
    found = get_close_matches(given, known, n=1, cutoff=alike)
    if not found and len(given) >= _LEAST_BEGINNING:
        found = [name for name in known if name.startswith(given)]
    return f"; did you mean {shortened(known[found[0]])}?" if found else ""


class InputError(Exception):
    """The user's input cannot be used; the message says why, and what is allowed.

    Args:
        lines: the message, mostly in one line. A line feed or another invisible character in it,
            as of a file's name, is shown as in Python's strings.
    """

    def __init__(self, *lines: str) -> None:
        super().__init__(*map(in_one_line, lines))

    def __str__(self) -> str:
        return "\n".join(self.args)

    def lines(self, before: str, after: str = "") -> list[str]:
        """Return its lines with a text before the first one and after the last one."""
        *others, last = [before + self.args[0], *self.args[1:]]
        return [*others, last + after]


class Stopped(BaseException):
    """A stop was requested before there was a run to end in order."""
