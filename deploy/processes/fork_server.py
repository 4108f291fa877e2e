"""What Python's fork server does before it forks: it alone imports this module, after the program.

A process of a run takes a second or two to load the program. Forked from one that has done so, and
that has no threads whatever `run` has, it takes none.
"""

import gc
import os

import numpy as np

from bus_schema.runtime.finite import all_finite

os.setsid()  # a signal to the process group of `run` is for `run` to hand on
all_finite(np.zeros(1))  # numba loads most of itself with the first compiled function
gc.freeze()  # what is there now stays, and is shared
