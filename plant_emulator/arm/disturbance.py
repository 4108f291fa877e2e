"""External torques on the joints: a sum of terms, each a function of time alone.

Every kind of term is converted to windowed sinusoids, amplitude × sin(frequency t + phase) from a
start to an end, in one small table. Band-limited noise is a sum of sinusoids of random frequency
and phase (Shinozuka and Deodatis, 1991): it has no state, so it does not depend on which instants
are computed.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from bus_schema.arrays import Records, Vector
from bus_schema.configuration import ConfigurationError
from bus_schema.errors import did_you_mean
from bus_schema.runtime.compiled import compiled
from plant_emulator.configuration import (
    ConstantTerm,
    DisturbanceConfiguration,
    DisturbanceTerm,
    NoiseTerm,
    PulseTerm,
    SineTerm,
    StepTerm,
)

NOISE_COMPONENTS = 48
_QUARTER_TURN = 0.5 * math.pi

_Wave: TypeAlias = tuple[float, float, float, float, float]
"""Amplitude, frequency, phase, start and end, as in a row of the table."""

_WAVE = np.dtype([
    ("joint", np.int64), ("amplitude_nm", np.float64), ("frequency_rad_s", np.float64),
    ("phase_rad", np.float64), ("start_s", np.float64), ("end_s", np.float64),
])  # fmt: skip


def disturbance_table(
    configuration: DisturbanceConfiguration,
    joint_names: tuple[str, ...],
    random: np.random.Generator,
) -> Records:
    """Return all terms, scaled, as windowed sinusoids, shape (sinusoids,).

    Raises:
        ConfigurationError: a term names an unknown joint, or a band whose limits are reversed.
    """
    waves: list[tuple[float, ...]] = []
    for index, term in enumerate(configuration.terms if configuration.enabled else []):
        if term.joint != "all" and term.joint not in joint_names:
            raise ConfigurationError(
                f"plant.disturbance.terms.{index}.joint",
                term.joint,
                f"must be all, or one of {', '.join(joint_names)}"
                + did_you_mean(term.joint, ["all", *joint_names]),
            )
        if isinstance(term, NoiseTerm) and term.highest_hz <= term.lowest_hz:
            key = f"plant.disturbance.terms.{index}.highest_hz"
            raise ConfigurationError(key, term.highest_hz, f"above lowest_hz = {term.lowest_hz}")
        for joint, name in enumerate(joint_names):
            if term.joint in ("all", name):
                waves.extend((joint, *wave) for wave in _waves(term, random))
    table = np.array(waves, dtype=_WAVE)
    table["amplitude_nm"] *= configuration.scale
    return table


@compiled
def add_disturbance(time_s: float, waves: Records, out: Vector) -> None:
    """Write the torque of all terms at `time_s` into `out`, shape (joints,), N m."""
    out[:] = 0.0
    for i in range(waves.size):
        wave = waves[i]
        if wave.start_s <= time_s < wave.end_s:
            angle = wave.frequency_rad_s * time_s + wave.phase_rad
            out[wave.joint] += wave.amplitude_nm * math.sin(angle)


def _waves(term: DisturbanceTerm, random: np.random.Generator) -> list[_Wave]:
    match term:
        case ConstantTerm():
            return [(term.torque_nm, 0.0, _QUARTER_TURN, 0.0, math.inf)]
        case SineTerm():
            return [(term.amplitude_nm, term.frequency_rad_s, term.phase_rad, 0.0, math.inf)]
        case StepTerm():
            return [(term.torque_nm, 0.0, _QUARTER_TURN, term.start_s, math.inf)]
        case PulseTerm():
            end_s = term.start_s + term.duration_s
            return [(term.torque_nm, 0.0, _QUARTER_TURN, term.start_s, end_s)]
        case NoiseTerm():
            return _noise(term, random)


def _noise(term: NoiseTerm, random: np.random.Generator) -> list[_Wave]:
    edges = np.linspace(term.lowest_hz, term.highest_hz, NOISE_COMPONENTS + 1)
    frequencies = 2.0 * math.pi * random.uniform(edges[:-1], edges[1:])
    phases = random.uniform(0.0, 2.0 * math.pi, NOISE_COMPONENTS)
    amplitude = term.rms_nm * math.sqrt(2.0 / NOISE_COMPONENTS)
    return [
        (amplitude, float(frequency), float(phase), 0.0, math.inf)
        for frequency, phase in zip(frequencies, phases, strict=True)
    ]
