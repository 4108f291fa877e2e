"""A command of the command line in a process of its own, forked from one that has it loaded."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import IO, NamedTuple

from setproctitle import setproctitle

_PROGRAM = "deploy.cli"
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload([f"{_PROGRAM}.processes", "deploy.processes.fork_server"])


class CommandProcess(NamedTuple):
    """A command under way, and this side of its standard streams."""

    process: BaseProcess
    stdin: IO[str]
    stdout: IO[str]
    stderr: IO[str]


def start(words: list[str]) -> CommandProcess:
    """Start `funnel-hil` with these words, in this folder.

    It ends with this process, and no signal of the terminal reaches it.
    """
    (stdin, to_it), (from_it, stdout), (errors, stderr) = (
        _CONTEXT.Pipe(duplex=False) for _ in range(3)
    )
    theirs = [stdin, stdout, stderr]
    process = _CONTEXT.Process(target=_be, args=(words, Path.cwd(), theirs), daemon=True)
    process.start()
    for end in theirs:
        end.close()
    return CommandProcess(process, _file(to_it, "w"), _file(from_it, "r"), _file(errors, "r"))


def _file(end: Connection, mode: str) -> IO[str]:
    with end:
        return os.fdopen(os.dup(end.fileno()), mode)


def _be(words: list[str], folder: Path, streams: list[Connection]) -> None:
    """Be the command."""
    os.setsid()
    os.chdir(folder)
    for number, stream in enumerate(streams):
        os.dup2(stream.fileno(), number)
        stream.close()
    # As with a new program, no other file is handed down: the fork server, on whose end this
    # process leaves, ends itself when nobody has the files of its clients open any longer.
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
    words = [*words, "--to-parent", str(os.getppid())]
    setproctitle(" ".join([sys.executable, "-m", _PROGRAM, *words]))  # for `ps` and the like
    sys.argv[1:] = words
    runpy.run_module(_PROGRAM, run_name="__main__", alter_sys=True)
