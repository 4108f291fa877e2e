"""The fork server: ``python -m deploy.run.processes.fork_server DOOR``, DOOR a socket's number.

A process of a run takes a second or two to load the program. A fork of this server, which has
loaded it and has few threads, takes no time for that. Each fork gets the environment variables of
`run`; those here belong to the fork server. `role_process` starts it and sends its requests.
"""

import contextlib
import gc
import logging
import os
import signal
import socket
import sys
import threading
import traceback
from multiprocessing.connection import Connection, wait
from typing import NoReturn

from bus_schema.runtime.child import PR_SET_PDEATHSIG, set_process_option

gc.disable()  # until all is loaded: garbage collection would take a sixth of that time
# It would live as long as one of its processes, and these leave when it ends.
set_process_option(PR_SET_PDEATHSIG, signal.SIGKILL)

import numpy as np  # noqa: E402 (takes its time, in which the command may end)

logging.disable()  # `run` itself reports where kernels are kept
from bus_schema.runtime.compiled import HAS_SAID  # noqa: E402

logging.disable(logging.NOTSET)
from bus_schema.runtime.compiled import all_finite  # noqa: E402

os.environ[HAS_SAID] = "1"  # `run` itself reports that it compiles this kernel
with contextlib.suppress(Exception):  # the process that needs it will report the error
    all_finite(np.zeros(1))  # numba loads most of its modules with the first compiled function

import deploy.run.processes.roles  # noqa: E402, F401
from deploy.run.closed_output import outlive_readers  # noqa: E402

outlive_readers()
gc.set_threshold(200_000)  # no run reaches this before it disables collection
gc.freeze()  # no child collects these objects, or copies their memory
gc.enable()


def serve(door: socket.socket) -> None:
    """Fork a process for each request, and report how it ended, until the command has ended.

    A request consists of file descriptors: a connection for everything else, and those that the
    process keeps.
    """
    running: dict[int, tuple[int, Connection]] = {}
    while True:
        for ready in wait([door, *running]):
            if ready is door:
                _, handles, _, _ = socket.recv_fds(door, 1, 2)
                if not handles:
                    return
                if (pid := os.fork()) == 0:
                    door.close()
                    for _, other in running.values():
                        other.close()
                    _run(Connection(handles[0]), handles[1:])
                for each in handles[1:]:
                    os.close(each)
                command = Connection(handles[0])
                command.send(pid)
                running[os.pidfd_open(pid)] = pid, command
            else:
                assert isinstance(ready, int)
                pid, command = running.pop(ready)
                os.close(ready)
                with contextlib.suppress(OSError), command:  # the command may have ended
                    command.send(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))


def _run(command: Connection, handles: list[int]) -> NoReturn:
    """Call the function of a request, and end this process with its exit code."""
    code = 1
    try:
        with command:
            sys.path[:], folder = command.recv()
            os.chdir(folder)
            function, arguments = command.recv()  # needs the path
        function(*map(Connection, handles), *arguments)
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException:  # noqa: BLE001 (the last to see it)
        traceback.print_exc()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)  # the libraries take long to leave in order


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
