"""What Python's fork server does before it forks: it alone imports this module.

A process of a run takes a second or two to load the program. Forked from one that has done so, and
that has no threads whatever `run` has, it takes none.
"""

import contextlib
import ctypes
import os
import signal
import sys

import numpy as np

from bus_schema.runtime.finite import all_finite
from deploy.processes.parent import FOR_FORK_SERVER, PR_SET_PDEATHSIG, SAFE_PATH

if os.environ.get(SAFE_PATH) == FOR_FORK_SERVER:  # no business of programs that others start
    del os.environ[SAFE_PATH]
if sys.platform == "linux":
    # It would live as long as one of its processes does, and these leave when it ends.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
with contextlib.suppress(Exception):  # whoever needs it will say what is wrong
    all_finite(np.zeros(1))  # numba loads most of itself with the first compiled function
