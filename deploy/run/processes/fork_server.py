"""What Python's fork server does before it forks: it alone imports this module.

A process of a run takes a second or two to load the program. Forked from one that has done so, and
that has few threads whatever `run` has, it takes none. Each is given the environment variables of
`run`; those here are the fork server's own.
"""

import contextlib
import ctypes
import gc
import logging
import os
import signal
import sys

gc.disable()  # until all is loaded: looking for garbage would be a sixth of that
if sys.platform == "linux":
    # It would live as long as one of its processes does, and these leave when it ends.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG

import numpy as np  # noqa: E402 (takes its time, in which the command may end)

logging.disable()  # where kernels are kept, `run` itself says
from bus_schema.runtime.compiled import HAS_SAID  # noqa: E402

logging.disable(logging.NOTSET)
from bus_schema.runtime.finite import all_finite  # noqa: E402

os.environ[HAS_SAID] = "1"  # of this kernel `run` itself says that it compiles it
with contextlib.suppress(Exception):  # whoever needs it will say what is wrong
    all_finite(np.zeros(1))  # numba loads most of itself with the first compiled function

import deploy.run.processes.roles  # noqa: E402, F401
from deploy.run.closed_output import outlive_readers  # noqa: E402

outlive_readers()
gc.set_threshold(200_000)  # more than a process of a run makes until it does without
gc.freeze()  # no child looks through all this again, nor copies the memory that it is in
gc.enable()
