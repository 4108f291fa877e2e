"""Eigenvalues of symmetric matrices, the same bits on every CPU.

LAPACK's differ: OpenBLAS picks its kernels by CPU, and each kernel rounds in another order.
"""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

_MOST_SWEEPS = 50
"""Ten suffice for the joints of an arm; the limit ends the loop for a matrix with NaN."""


def eigenvalues(matrix: Matrix) -> tuple[Vector, Matrix]:
    """Return a symmetric matrix's eigenvalues, in any order, and unit eigenvectors as columns."""
    a, vectors = np.array(matrix, np.float64, order="C"), np.eye(len(matrix))
    _diagonalize(a, vectors)
    return a.diagonal().copy(), vectors


@compiled
def _diagonalize(a: Matrix, vectors: Matrix) -> None:
    """Apply Jacobi's rotations row by row until all off-diagonal values are below rounding."""
    n = a.shape[0]
    for _ in range(_MOST_SWEEPS):
        is_diagonal = True
        for p in range(n):
            for q in range(p + 1, n):
                off, first, last = abs(a[p, q]), abs(a[p, p]), abs(a[q, q])
                if first + off == first and last + off == last:
                    continue
                is_diagonal = False
                ratio = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
                c = 1.0 / math.sqrt(tangent * tangent + 1.0)
                s = c * tangent
                _rotate(a.T, p, q, c, s)
                _rotate(a, p, q, c, s)
                _rotate(vectors, p, q, c, s)
                a[p, q] = a[q, p] = 0.0
        if is_diagonal:
            break


@compiled
def _rotate(matrix: Matrix, p: int, q: int, c: float, s: float) -> None:
    """Rotate columns p and q in their plane."""
    for k in range(matrix.shape[0]):
        at_p, at_q = matrix[k, p], matrix[k, q]
        matrix[k, p] = c * at_p - s * at_q
        matrix[k, q] = s * at_p + c * at_q
