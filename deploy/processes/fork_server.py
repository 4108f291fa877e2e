"""What Python's fork server does before it forks: it alone imports this module.

A process of a run takes a second or two to load the program. Forked from one that has done so, and
that has few threads whatever `run` has, it takes none.
"""

import contextlib
import ctypes
import gc
import logging
import os
import signal
import sys
from importlib import import_module

from deploy.processes.parent import FOR_FORK_SERVER, PR_SET_PDEATHSIG, PROGRAM, SAFE_PATH

gc.disable()  # until all is loaded: looking for garbage would be a sixth of that
if os.environ.get(SAFE_PATH) == FOR_FORK_SERVER:  # no business of programs that others start
    del os.environ[SAFE_PATH]
if sys.platform == "linux":
    # It would live as long as one of its processes does, and these leave when it ends.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)

import numpy as np  # noqa: E402 (takes its time, in which the command may end)

logging.disable()  # where kernels are kept, `run` itself says
from bus_schema.runtime.compiled import HAS_SAID  # noqa: E402

logging.disable(logging.NOTSET)
from bus_schema.runtime.finite import all_finite  # noqa: E402

has_said = HAS_SAID in os.environ
os.environ[HAS_SAID] = "1"  # of this kernel `run` itself says that it compiles it
with contextlib.suppress(Exception):  # whoever needs it will say what is wrong
    all_finite(np.zeros(1))  # numba loads most of itself with the first compiled function
if not has_said:
    del os.environ[HAS_SAID]  # of others the processes tell `run`, which says it once

import_module(f"{PROGRAM}.processes")
gc.freeze()  # no child looks through all this again, nor copies the memory that it is in
gc.enable()
