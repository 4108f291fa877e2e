"""Array types shared by every room."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Vector: TypeAlias = NDArray[np.float64]
"""One value per joint, shape (joints,)."""

Matrix: TypeAlias = NDArray[np.float64]
"""Two axes of float64."""
