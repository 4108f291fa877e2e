"""Root of the errors of a running controller."""

from __future__ import annotations

import signal
import traceback

from bus_schema.errors import Stopped


class ControllerError(Exception):
    """Root of the errors of a running controller."""


_LONGEST = 300
_FIRST, _LAST = 1, 2
"""Frames shown of a long traceback: the call of the law, and where it raised."""


class LawError(ControllerError):
    """A law raised.

    Args:
        law: its name.
        tick: cycle in which it raised; None before the first.
        error: its exception, with the traceback from the caller of the law on.
    """

    def __init__(self, law: str, tick: int | None, error: BaseException) -> None:
        when = "before the first tick" if tick is None else f"at tick {tick}"
        super().__init__(f"law {law} failed {when}: {described(error)}")


def is_of_the_law(error: BaseException) -> bool:
    """Whether an exception within a law came from the law, not from a request to stop."""
    if isinstance(error, KeyboardInterrupt):  # raised by Ctrl-C only if no handler is installed
        return signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return not isinstance(error, Stopped)


def described(error: BaseException) -> str:
    """Return an exception of the user's code on one printable line, and where it was raised."""
    return f"{_message(error)}{_places(error)}"


def _message(error: BaseException) -> str:
    text = " ".join("".join(traceback.format_exception_only(error)).split())
    text = "".join(letter if letter.isprintable() else "\ufffd" for letter in text)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _places(error: BaseException) -> str:
    """Return file, line and function of the first and the last frames, without the caller's."""
    frames = [
        f"{frame.filename}:{frame.lineno} in {frame.name}"
        for frame in traceback.extract_tb(error.__traceback__)[1:]
        if not frame.filename.startswith("<frozen")
    ]
    if len(frames) > _FIRST + _LAST:
        frames = [*frames[:_FIRST], "…", *frames[-_LAST:]]
    return f" ({', '.join(frames)})" if frames else ""
