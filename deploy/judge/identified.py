"""What a compensated run identified of its arm, and what the arm really was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.configuration import expand
from bus_schema.messages import topics
from deploy.judge.run_data import RunData
from deploy.scenario.setup import Setup
from plant_emulator.faults.arm_faults import payload_steps

FIELDS = {
    "inertia_factor": ("inertia_factor", 1.0),
    "payload_kg": ("payload_kg", 1.0),
    "lag_ms": ("actuator_lag_s", 1e3),
    "coulomb_nm": ("learned_friction", 1.0),
    "viscous_nm_s": ("learned_viscous", 1.0),
}
"""Name in the summary, with its unit → field of `control_status`, and the factor between them."""


@dataclass(frozen=True)
class Truth:
    """What there was to be found, as far as a scenario says it.

    Attributes:
        inertia_factor: masses and inertias of the arm over those of the nominal model.
        payload_kg: from when on, s, and how much, kg.
        lag_ms: time constant of the actuators.
        coulomb_nm: dry friction at speed, shape (joints,).
        viscous_nm_s: friction per rad/s, shape (joints,).
    """

    inertia_factor: float
    payload_kg: list[tuple[float, float]]
    lag_ms: float
    coulomb_nm: Vector
    viscous_nm_s: Vector


def truth_over_time(setup: Setup) -> Truth:
    """What the emulated arm really is."""
    scenario, joints = setup.scenario, setup.robot.joints
    friction, key = scenario.plant.friction, "plant.friction"
    share = float(friction.enabled)
    return Truth(
        inertia_factor=1.0 / scenario.controller.model_scale,
        payload_kg=payload_steps(scenario.plant.payload_kg, scenario.faults),
        lag_ms=scenario.plant.actuator.lag_ms,
        coulomb_nm=share * expand(friction.coulomb_nm, joints, f"{key}.coulomb_nm"),
        viscous_nm_s=share * expand(friction.viscous_nm_s, joints, f"{key}.viscous_nm_s"),
    )


def series(run: RunData, name: str) -> Vector | None:
    """What was believed at every cycle, shape (cycles,) or (cycles, joints); None if nothing was.

    Args:
        run: the run.
        name: one of `FIELDS`.
    """
    settings = run.setup.scenario.controller.delay_compensation
    field, factor = FIELDS[name]
    is_learned = settings.learn_friction if name == "coulomb_nm" else settings.identify_model
    values = factor * run.tables[topics.CONTROL_STATUS.name][field]
    return values if is_learned and np.isfinite(values).any() else None


def identified(run: RunData) -> dict[str, Any] | None:
    """What was believed at the end, and under ``truth`` what was so; None if nothing was learned.

    A value is None where it is not among what was to be learned.
    """
    final: dict[str, Any] = {}
    for name in FIELDS:
        values = series(run, name)
        final[name] = None if values is None else values[-1].tolist()
    if all(value is None for value in final.values()):
        return None
    truth, end_s = truth_over_time(run.setup), run.times_s(topics.CONTROL_STATUS)[-1]
    known = {
        "inertia_factor": truth.inertia_factor,
        "payload_kg": [kg for at_s, kg in truth.payload_kg if at_s <= end_s][-1],
        "lag_ms": truth.lag_ms,
        "coulomb_nm": truth.coulomb_nm.tolist(),
        "viscous_nm_s": truth.viscous_nm_s.tolist(),
    }
    return {**final, "truth": known}
