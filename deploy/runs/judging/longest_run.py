"""How often something was so in a row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deploy.runs.judging.known_ticks import NO_ROWS, Rows


def longest_run(flags: NDArray[np.bool_], after_gaps: Rows = NO_ROWS) -> int:
    """The largest number of flags in a row that are set.

    Args:
        flags: one a tick.
        after_gaps: those before which some are missing, of which nobody knows whether they were.
    """
    flags = np.insert(flags, after_gaps, False)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0
