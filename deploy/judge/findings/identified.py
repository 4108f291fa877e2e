"""Model values that a compensated run identified, and the arm's true values."""

from __future__ import annotations

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


def truth_of(setup: Setup) -> dict[str, Any]:
    """Return the emulated arm's true values, by the names of `FIELDS`.

    For the payload: start time, s, and mass, kg; for friction a value for each joint.
    """
    scenario, joints = setup.scenario, setup.robot.joints
    friction, key = scenario.plant.friction, "plant.friction"
    share = float(friction.enabled)
    return {
        "inertia_factor": 1.0 / scenario.controller.model_scale,
        "payload_kg": payload_steps(scenario.plant.payload_kg, scenario.faults),
        "lag_ms": scenario.plant.actuator.lag_ms,
        "coulomb_nm": share * expand(friction.coulomb_nm, joints, f"{key}.coulomb_nm"),
        "viscous_nm_s": share * expand(friction.viscous_nm_s, joints, f"{key}.viscous_nm_s"),
    }


def series(run: RunData, name: str) -> Vector | None:
    """Return the belief at every cycle, shape (cycles,) or (cycles, joints); None without any.

    Args:
        run: the run.
        name: one of `FIELDS`.
    """
    settings = run.setup.scenario.controller.delay_compensation
    field, factor = FIELDS[name]
    is_learned = settings.learns_friction if name == "coulomb_nm" else settings.learns_model
    values = factor * run.tables[topics.CONTROL_STATUS.name][field]
    return values if is_learned and np.isfinite(values).any() else None


def identified(run: RunData) -> dict[str, Any] | None:
    """Return the belief at the end, and the true values under ``truth``; None without any.

    A value that was not to be learned is None.
    """
    believed = {name: series(run, name) for name in FIELDS}
    final = {name: None if v is None else v[-1].tolist() for name, v in believed.items()}
    if all(value is None for value in final.values()):
        return None
    truth, end_s = truth_of(run.setup), run.times_s(topics.CONTROL_STATUS)[-1]
    carried = [kg for at_s, kg in truth["payload_kg"] if at_s <= end_s][-1]
    friction = {name: truth[name].tolist() for name in ("coulomb_nm", "viscous_nm_s")}
    return {**final, "truth": {**truth, "payload_kg": carried, **friction}}
