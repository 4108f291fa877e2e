"""The process of an external law: started with the first question, ended by closing its input."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import subprocess
import tempfile
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.runtime.child import last_line, signal_name
from controller.errors import ControllerError

_LAST_WORDS = 2000
_GRACE_S = 1.0


class ExternalLawError(ControllerError):
    """The program of an external law failed."""


class LawProgram:
    """A child process that answers questions.

    Args:
        command: the program and its arguments.
        question: buffer of the question, sent as it is at each `ask`.
        answer: buffer for the answers.
    """

    def __init__(self, command: Sequence[str], question: Vector, answer: Vector) -> None:
        self._name = " ".join(command)
        self._question, self._answer = question.view(np.uint8).data, answer.view(np.uint8).data
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (open as long as this)
        try:
            self._process = subprocess.Popen(
                list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._words,
                bufsize=0,
            )  # fmt: skip
        except OSError as error:
            raise ExternalLawError(
                f"external law {self._name} cannot be started: {error}"
            ) from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._poll = select.poll()
        self._poll.register(self._from, select.POLLIN)
        self.end = weakref.finalize(self, _end, self._process, self._words)

    def ask(self, timeout_s: float) -> None:
        """Send the question, and wait for the answer.

        Raises:
            ExternalLawError: the program has ended, or does not answer in time.
        """
        give_up_s = time.monotonic() + timeout_s
        try:
            os.write(self._to, self._question)  # whole: the pipe is empty, and large enough
        except OSError:
            raise self._gone() from None
        received, wanted = 0, self._answer.nbytes
        while received < wanted:
            left_s = give_up_s - time.monotonic()  # the same limit for all parts of an answer
            if not self._poll.poll(1e3 * max(0.0, left_s)):
                self.end()
                raise ExternalLawError(
                    f"external law {self._name} did not answer within {timeout_s:g} s"
                )
            count = os.readv(self._from, [self._answer[received:]])
            if count == 0:
                raise self._gone()
            received += count

    def _gone(self) -> ExternalLawError:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_GRACE_S)
        code = self._process.poll()
        how = "closed its output"
        if code is not None:
            by_signal = f"was ended by {signal_name(-code)}"
            how = by_signal if code < 0 else f"ended with exit code {code}"
        size = os.fstat(self._words.fileno()).st_size
        written = os.pread(self._words.fileno(), _LAST_WORDS, max(0, size - _LAST_WORDS))
        words = f"; end of its standard error: {line}" if (line := last_line(written)) else ""
        self.end()
        return ExternalLawError(f"external law {self._name} {how}{words}")


def _end(process: subprocess.Popen[bytes], words: IO[bytes]) -> None:
    """Close the program's input, which ends it; terminate it if it does not end."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    try:
        process.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    words.close()


def why_not_startable(command: Sequence[str]) -> str | None:
    """Explain why a command cannot be started; None if no reason is found."""
    name = command[0]
    if shutil.which(name) is not None:
        return None
    is_there = os.sep in name and Path(name).is_file()
    return f"{name} is not executable" if is_there else f"there is no program {name}"
