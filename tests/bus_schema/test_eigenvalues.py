"""Eigenvalues of symmetric matrices: those of LAPACK, to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from bus_schema.eigenvalues import eigenvalues


@pytest.mark.parametrize("size", [1, 2, 3, 7, 12])
def test_eigenvalues_and_vectors_are_those_of_lapack(size):
    random = np.random.default_rng(size)
    for scale in (1e-9, 1.0, 1e9):
        half = random.normal(size=(size, size))
        matrix = scale * (half + half.T)
        values, vectors = eigenvalues(matrix)
        np.testing.assert_allclose(
            np.sort(values), np.linalg.eigvalsh(matrix), rtol=1e-12, atol=1e-13 * scale
        )
        np.testing.assert_allclose(vectors * values @ vectors.T, matrix, atol=1e-13 * scale)
        np.testing.assert_allclose(vectors.T @ vectors, np.eye(size), atol=1e-14)


def test_a_diagonal_matrix_keeps_its_values_and_one_with_nan_ends():
    np.testing.assert_array_equal(eigenvalues(np.diag([3.0, 0.0, 3.0]))[0], [3.0, 0.0, 3.0])
    assert np.isnan(eigenvalues(np.full((3, 3), np.nan))[0]).all()
