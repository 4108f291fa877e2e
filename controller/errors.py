"""The root of what goes wrong in a running controller."""

from __future__ import annotations

import signal
import traceback

from bus_schema.errors import Stopped


class ControllerError(Exception):
    """Root of the errors of a running controller."""


_LONGEST = 300
_FIRST, _LAST = 1, 2
"""Frames that are told of a long traceback: where the law was called, and where it raised."""


class LawError(ControllerError):
    """A law raised.

    Args:
        law: its name.
        tick: cycle in which it did; None before the first.
        error: what it raised, with its traceback from the caller of the law on.
    """

    def __init__(self, law: str, tick: int | None, error: BaseException) -> None:
        when = "before the first tick" if tick is None else f"at tick {tick}"
        super().__init__(f"law {law} failed {when}: {_described(error)}{_places(error)}")


def is_of_the_law(error: BaseException) -> bool:
    """Whether something raised within a law came from it, rather than from a request to stop."""
    if isinstance(error, KeyboardInterrupt):  # which Ctrl-C raises only where nothing handles it
        return signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return not isinstance(error, Stopped)


def _described(error: BaseException) -> str:
    """Type and message on one line that can be shown and recorded, with any message."""
    text = " ".join("".join(traceback.format_exception_only(error)).split())
    text = "".join(letter if letter.isprintable() else "\ufffd" for letter in text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _places(error: BaseException) -> str:
    """File, line and function of the first and the last frames, without that of the caller."""
    frames = [
        f"{frame.filename}:{frame.lineno} in {frame.name}"
        for frame in traceback.extract_tb(error.__traceback__)[1:]
    ]
    if len(frames) > _FIRST + _LAST:
        frames = [*frames[:_FIRST], "…", *frames[-_LAST:]]
    return f" ({', '.join(frames)})" if frames else ""
