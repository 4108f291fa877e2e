"""Least squares with a prior, and the covariance of its parameters.

The covariance is H⁻¹ (S + P) H⁻¹, with H the information of prior and log, S the covariance of the
sums of scores under noise that is correlated in time, and P the information of the prior.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InputError, needs_extra
from controller.manipulator_model import body_from_log_cholesky
from deploy.measure.identify.noise import covariance_of_sums
from deploy.measure.identify.regression import Columns

_OF_BODIES = 1.1
"""Factor on standard deviations of bodies, whose columns have the noise of the positions."""


def bodies_of(coordinates: Vector) -> tuple[Vector, Matrix]:
    """Return the parameters of bodies, and their derivatives, a block for each body."""
    slopes = np.zeros((coordinates.size, coordinates.size))
    values = np.empty(coordinates.size)
    for start in range(0, coordinates.size, 10):
        rows = slice(start, start + 10)
        values[rows], slopes[rows, rows] = body_from_log_cholesky(coordinates[rows])
    return values, slopes


class Problem:
    """Least squares with a prior, in coordinates that are 0 at the prior with deviation 1."""

    def __init__(
        self, columns: Columns, centre: Vector, spread: Vector, lowest: Vector, bodies: int
    ) -> None:
        self._columns, self._bodies = columns, bodies
        self._centre, self._spread = centre, spread
        self._lowest = (lowest - centre) / spread

    @property
    def start(self) -> Vector:
        return self._centre

    @property
    def torque(self) -> Matrix:
        return self._columns.torque

    def _linear(self, x: Vector) -> tuple[Vector, Matrix]:
        """Return linear parameters, and their derivatives by scaled coordinates."""
        values, slopes = bodies_of(x[: self._bodies])
        jacobian = np.diag(self._spread)
        jacobian[: self._bodies, : self._bodies] = slopes * self._spread[: self._bodies]
        return np.concatenate([values, x[self._bodies :]]), jacobian

    def residuals(self, x: Vector) -> Matrix:
        """Return measured minus predicted torque, shape (samples, joints)."""
        return np.asarray(self._columns.torque - self._columns.design @ self._linear(x)[0])

    def solve(self, x: Vector, weights: Matrix) -> Vector:
        """Return the best parameters, for a weight of each sample and joint."""
        least_squares, qr = scipy_parts()
        design = (self._columns.design * weights[:, :, None]).reshape(-1, x.size)
        wanted = (self._columns.torque * weights).reshape(-1, 1)
        (r,) = qr(np.hstack([design, wanted]), mode="r", overwrite_a=True, check_finite=False)
        r = r[: x.size + 1]
        triangle, right = r[:, :-1], r[:, -1]

        def residuals(z: Vector) -> Vector:
            linear, _ = self._linear(self._centre + self._spread * z)
            return np.concatenate([triangle @ linear - right, z])

        def jacobian(z: Vector) -> Matrix:
            _, slopes = self._linear(self._centre + self._spread * z)
            return np.vstack([triangle @ slopes, np.eye(z.size)])

        z = np.maximum((x - self._centre) / self._spread, self._lowest + 1e-9)
        solved = least_squares(
            residuals, z, jacobian, bounds=(self._lowest - 1e-9, np.inf), xtol=1e-7, ftol=1e-9,
            max_nfev=60,
        )  # fmt: skip
        found: Vector = self._centre + self._spread * solved.x
        return found

    def covariance(self, x: Vector, weights: Matrix, cutoff_hz: float) -> Matrix:
        """Return the covariance of the parameters, for residuals that are correlated in time.

        Args:
            x: the parameters.
            weights: of each sample and joint.
            cutoff_hz: of the filter of the samples.
        """
        columns, (_, slopes) = self._columns, self._linear(x)
        left = self.residuals(x) * weights
        design = (columns.design * weights[:, :, None]) @ slopes
        flat = design.reshape(-1, x.size)
        inverse = np.linalg.inv(flat.T @ flat + np.eye(x.size))
        sums = covariance_of_sums(design, left, columns.times_s, columns.runs, cutoff_hz)
        found = inverse @ (sums + np.eye(x.size)) @ inverse
        wider = np.sqrt(np.maximum(np.diag(inverse) / np.diag(found), 1.0))
        wider[: self._bodies] *= _OF_BODIES
        scale = wider * self._spread
        return np.asarray(found * np.outer(scale, scale))


def scipy_parts() -> Any:
    """Return scipy's `least_squares` and `qr`.

    With one thread: the matrices are small, and threads that wait for each other take many times as
    long on a busy machine. SciPy's own BLAS reads this when it is loaded.

    Raises:
        InputError: it is not installed.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from scipy.linalg import qr  # an extra, needed by this command alone
        from scipy.optimize import least_squares
    except ImportError as error:
        raise InputError(f"identify {needs_extra('scipy', 'identify')} ({error})") from error
    return least_squares, qr
