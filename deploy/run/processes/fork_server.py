"""Preparation of Python's fork server, which alone imports this module.

A process of a run takes a second or two to load the program. A fork of this server, which has
loaded it and has few threads, takes no time for that. Each fork gets the environment variables of
`run`; those here belong to the fork server.
"""

import contextlib
import gc
import logging
import os
import signal

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
