"""Standard streams that are closed early, as by ``funnel-hil … | head -1``.

The same applies to streams that fail, such as a file on a full disk.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from typing import TextIO

_GONE = (errno.EPIPE,)
_LOST = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
"""Errors that mean lost output, which the user must learn of."""

parent_reports = False
"""Whether the parent of this process has the same output, and says that it is lost."""


class _DiscardsAfterError(io.FileIO):
    """A file descriptor that discards everything once a write fails."""

    def write(self, data: object) -> int:
        view = memoryview(data)  # type: ignore[arg-type]
        try:
            written = super().write(view)
        except OSError as error:
            if error.errno not in _GONE and error.errno not in _LOST:
                raise
            if error.errno in _LOST and self.fileno() == 1 and not parent_reports:
                with contextlib.suppress(OSError):
                    os.write(2, f"standard output is lost: {error.strerror}\n".encode())
            _discard(self.fileno())
            return view.nbytes
        return written or 0


def outlive_readers() -> None:
    """Let the process continue to its end and its exit code when its output is closed."""
    sys.stdout = _tolerant(sys.stdout, 1)
    sys.stderr = _tolerant(sys.stderr, 2)


def _tolerant(stream: TextIO | None, number: int) -> TextIO:
    if stream is None:  # closed at the start
        _discard(number)
        return open(number, "w", errors="replace", closefd=False)
    try:
        is_standard = stream.fileno() == number
    except (OSError, ValueError):
        is_standard = False
    if not is_standard:  # other code replaced it, and reads it
        return stream
    stream.flush()
    raw = _DiscardsAfterError(number, "w", closefd=False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=stream.encoding,
        errors="replace" if stream.errors == "strict" else stream.errors,  # unencodable
        line_buffering=number == 2 or stream.isatty(),
    )  # fmt: skip


def _discard(number: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
