"""What Python's fork server does before it forks: it alone imports this module.

A process of a run takes a second or two to load the program. Forked from one that has done so, and
that has few threads whatever `run` has, it takes none.
"""

import contextlib
import ctypes
import gc
import os
import signal
import sys

from deploy.processes.parent import FOR_FORK_SERVER, PR_SET_PDEATHSIG, SAFE_PATH

gc.set_threshold(20_000)  # as the command line does: Python's 700 make loading a third slower
if os.environ.get(SAFE_PATH) == FOR_FORK_SERVER:  # no business of programs that others start
    del os.environ[SAFE_PATH]
if sys.platform == "linux":
    # It would live as long as one of its processes does, and these leave when it ends.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)

import numpy as np  # noqa: E402 (takes its time, in which the command may end)

from bus_schema.runtime.finite import all_finite  # noqa: E402

with contextlib.suppress(Exception):  # whoever needs it will say what is wrong
    all_finite(np.zeros(1))  # numba loads most of itself with the first compiled function
