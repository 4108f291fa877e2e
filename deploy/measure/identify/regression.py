"""The linear parts of the model: what each parameter adds to the torques of a motion.

    τ = Y(q, q̇, q̈) φ + J q̈ + (f_c + f_s e^{-(q̇/v_s)²} + f_l |Y φ|) tanh(q̇ / v) + f_v q̇ + c + δ τ̇

φ are the bodies' parameters; J, f and c those of each joint; δ is how far measured torques are
ahead of the motion. All columns are filtered as the torques are: the filter changes neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.signals import Samples, lowpass

COULOMB, VISCOUS, OFFSET, ROTOR, STRIBECK, LOAD = range(6)
TERMS = ("coulomb_nm", "viscous_nm_s", "offset_nm", "rotor_inertia_kg_m2", "stribeck_nm",
         "load_share")  # fmt: skip
"""Parameters of a joint, by the keys of a scenario."""
STRIBECK_VELOCITY_RAD_S = 0.1
_PER_CUTOFF = 5.0
"""Rate of the samples that are kept after filtering, over the cutoff."""
SMOOTHING_RAD_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)


@dataclass(frozen=True)
class Trial:
    """A motion ready for regression; only samples near rows of the log.

    Attributes:
        bodies: Y, shape (samples, joints, 10 × bodies).
        samples: the motion.
        kept: whether each sample of `samples` is used.
    """

    bodies: NDArray[np.float64]
    samples: Samples
    kept: NDArray[np.bool_]

    @property
    def torque(self) -> Matrix:
        return self.samples.torque[self.kept]

    @property
    def times_s(self) -> Vector:
        return self.samples.times_s[self.kept]

    def joint_columns(self, smoothing_rad_s: Vector, parameters: Vector) -> NDArray[np.float64]:
        """Return the columns of `TERMS`, shape (samples, joints, terms).

        Args:
            smoothing_rad_s: v, shape (joints,).
            parameters: φ, for load-dependent friction. The measured torque would explain itself.
        """
        s = self.samples
        sign = np.tanh(s.velocity / smoothing_rad_s)
        stribeck = sign * np.exp(-((s.velocity / STRIBECK_VELOCITY_RAD_S) ** 2))
        ones = np.ones_like(sign)
        stacked = np.stack([sign, s.velocity, ones, s.acceleration, stribeck], axis=2)
        found = lowpass(stacked, s.rate_hz, s.cutoff_hz)[self.kept]
        load = np.abs(self.bodies @ parameters) * found[:, :, 0]
        return np.concatenate([found, load[:, :, None]], axis=2)

    def part(self, chosen: NDArray[np.bool_]) -> Trial:
        """Return the samples chosen among those that are used."""
        kept = self.kept.copy()
        kept[kept] = chosen
        return Trial(self.bodies[chosen], self.samples, kept)


def trial_of(samples: Samples, model: ManipulatorModel) -> Trial:
    """Return a motion with its regressors."""
    bodies = model.torque_regressors(samples.position, samples.velocity, samples.acceleration)
    filtered = lowpass(bodies, samples.rate_hz, samples.cutoff_hz)
    every = max(1, int(samples.rate_hz / (_PER_CUTOFF * samples.cutoff_hz)))
    kept = samples.is_known & (np.arange(len(filtered)) % every == 0)
    return Trial(filtered[kept], samples, kept)


def split(trial: Trial, held_out: float) -> tuple[Trial, Trial]:
    """Return the beginning of a motion, and the share at its end that is held out."""
    at_s = trial.times_s[0] + (1.0 - held_out) * (trial.times_s[-1] - trial.times_s[0])
    early = trial.times_s < at_s
    return trial.part(early), trial.part(~early)


class Columns(NamedTuple):
    """All trials of a fit, stacked.

    Attributes:
        design: shape (samples, joints, parameters): bodies, then terms by joint, then δ.
        torque: shape (samples, joints), N m.
        runs: number of the trial of each sample.
        times_s: of each sample in its trial.
    """

    design: NDArray[np.float64]
    torque: Matrix
    runs: NDArray[np.int64]
    times_s: Vector


def columns_of(
    trials: list[Trial], smoothing_rad_s: Vector, constants: Vector, terms: NDArray[np.bool_],
    parameters: Vector,
) -> Columns:  # fmt: skip
    """Stack trials.

    Args:
        trials: the motions.
        smoothing_rad_s: shape (joints,).
        constants: N m per unit of the logged torques, shape (joints,).
        terms: which of `TERMS` each joint has, shape (joints, terms).
        parameters: φ, for load-dependent friction.
    """
    joints, designs = len(constants), list[NDArray[np.float64]]()
    joint_of, term_of = np.nonzero(terms)
    for trial in trials:
        felt = trial.joint_columns(smoothing_rad_s, parameters)
        own = np.zeros((len(felt), joints, joint_of.size))
        own[:, joint_of, np.arange(joint_of.size)] = felt[:, joint_of, term_of]
        late = (trial.samples.torque_rate * constants)[trial.kept][:, :, None]
        designs.append(np.concatenate([trial.bodies, own, late], axis=2))
    runs = np.concatenate([np.full(len(each), i) for i, each in enumerate(designs)])
    torque = np.concatenate([trial.torque for trial in trials]) * constants
    times_s = np.concatenate([trial.times_s for trial in trials])
    return Columns(np.concatenate(designs), torque, runs, times_s)
