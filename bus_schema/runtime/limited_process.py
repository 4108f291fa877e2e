"""Limits for work on untrusted files: in another process, or on the memory of this one."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus_schema.runtime.child import how_it_ended

_WAIT_S, _MEMORY_BYTES = 30.0, 1 << 30


class LimitedProcessError(Exception):
    """The process gave no answer; the message says how it ended."""


class LimitedProcess:
    """A Python process that reads an order from standard input and answers on standard output.

    Args:
        module: its program, which calls `limit_this_process` first.
        order: what it reads.
    """

    def __init__(self, module: str, order: bytes) -> None:
        with tempfile.TemporaryFile() as file:  # with a pipe, one process would wait for the other
            file.write(order)
            file.seek(0)
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", module],
                stdin=file, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,  # Ctrl-C is for the command alone
            )  # fmt: skip

    def answer(self) -> bytes:
        """Wait for the answer.

        Raises:
            LimitedProcessError: the process crashed, or exceeded its time or memory.
        """
        answer: bytes | None = None
        with self._process as process:
            try:
                answer, _ = process.communicate(timeout=_WAIT_S)
            except subprocess.TimeoutExpired:
                pass
            finally:
                process.kill()
        if code := process.returncode:
            raise LimitedProcessError(how_it_ended(code))
        if answer is None:  # it ended by itself just before it was killed
            raise LimitedProcessError(f"no answer within {_WAIT_S:g} s")
        return answer


@contextmanager
def limited_memory(more_bytes: int) -> Iterator[None]:
    """Let this process take only so much more memory while the context lasts.

    Beyond it, allocations raise `MemoryError`. Without ``/proc`` there is no limit.
    """
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        yield
        return
    known = [each for each in (before, hard) if each != resource.RLIM_INFINITY]
    limit = min([pages * resource.getpagesize() + more_bytes, *known])
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))


def limit_this_process(cpu_s: int) -> None:
    """Limit the CPU time and the memory that this process may take."""
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
