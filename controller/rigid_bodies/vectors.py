"""3-D vectors as triples, and small matrices, for compiled code."""

from __future__ import annotations

import math

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled, scratch

Vec = tuple[float, float, float]


@compiled
def add(a: Vec, b: Vec) -> Vec:
    """A + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def scaled(factor: float, a: Vec) -> Vec:
    """A factor times a."""
    return factor * a[0], factor * a[1], factor * a[2]


@compiled
def dot(a: Vec, b: Vec) -> float:
    """A · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vec, b: Vec) -> Vec:
    """A × b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@compiled
def get(table: Matrix, row: int) -> Vec:
    """A row of a table, shape (rows, 3)."""
    return table[row, 0], table[row, 1], table[row, 2]


@compiled
def put(table: Matrix, row: int, a: Vec) -> None:
    """Write a row of a table, shape (rows, 3)."""
    table[row, 0], table[row, 1], table[row, 2] = a


@compiled
def rotated(rotation: Matrix, a: Vec) -> Vec:
    """R a."""
    return (
        rotation[0, 0] * a[0] + rotation[0, 1] * a[1] + rotation[0, 2] * a[2],
        rotation[1, 0] * a[0] + rotation[1, 1] * a[1] + rotation[1, 2] * a[2],
        rotation[2, 0] * a[0] + rotation[2, 1] * a[1] + rotation[2, 2] * a[2],
    )


@compiled
def turned(rotation: Matrix, axis: Vec, angle: float, out: Matrix) -> None:
    """Write `rotation` followed by a turn about an axis (Rodrigues' formula) into `out`."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis
    d = 1.0 - c
    for row in range(3):
        a, b, e = rotation[row, 0], rotation[row, 1], rotation[row, 2]
        along = d * (a * x + b * y + e * z)
        out[row, 0] = c * a + s * (b * z - e * y) + along * x
        out[row, 1] = c * b + s * (e * x - a * z) + along * y
        out[row, 2] = c * e + s * (a * y - b * x) + along * z


@compiled
def product(matrix: Matrix, vector: Vector) -> Vector:
    """Return M v, each sum in the order of the columns; `@` rounds as BLAS does on this CPU."""
    result = np.empty(matrix.shape[0])
    for row in range(matrix.shape[0]):
        total = 0.0
        for column in range(matrix.shape[1]):
            total += matrix[row, column] * vector[column]
        result[row] = total
    return result


@compiled
def invert(mass: Matrix, inverse: Matrix) -> None:
    """Write M⁻¹ into `inverse` by Cholesky's M = L Lᵀ; `mass` is not changed."""
    n = mass.shape[0]
    lower = scratch((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = mass[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
    for column in range(n):
        for i in range(n):
            total = 1.0 if i == column else 0.0
            for k in range(i):
                total -= lower[i, k] * inverse[k, column]
            inverse[i, column] = total / lower[i, i]
        for i in range(n - 1, -1, -1):
            total = inverse[i, column]
            for k in range(i + 1, n):
                total -= lower[k, i] * inverse[k, column]
            inverse[i, column] = total / lower[i, i]
