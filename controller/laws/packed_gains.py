"""Gains as compiled code takes them: one array instead of a tuple of many."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


def pack(gains: NamedTuple) -> NDArray[np.void]:
    """Gains as a structured array of one element, whose fields bear the names of the gains.

    To hand a named tuple to compiled code costs as much as half of the law itself, because each of
    its entries is converted at every call.
    """
    values: dict[str, Any] = gains._asdict()
    dtype = np.dtype([(name, np.float64, np.shape(value)) for name, value in values.items()])
    packed = np.zeros(1, dtype)
    for name, value in values.items():
        packed[name] = value
    return packed
