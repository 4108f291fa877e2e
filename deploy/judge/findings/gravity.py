"""Sag: a joint that its own weight moves away, as its law has no term for gravity."""

from __future__ import annotations

import numpy as np

from bus_schema.messages import topics
from controller.laws import LAWS
from controller.manipulator_model import ManipulatorModel
from deploy.judge.run_data import RunData


def with_gravity(law: str) -> str | None:
    """Return the law that has the gravity term which `law` lacks; None if that is not known."""
    return LAWS[law].with_gravity if law in LAWS else None


def sags(run: RunData, joint: int, tick: int) -> bool:
    """Whether gravity, which the law does not know, moves a joint away from its reference.

    It does if the error has the direction of the weight, and the weight exceeds all other torques
    that the law does not know: friction, disturbance, and the part of the weight, as of a payload,
    that a gravity term does not know either. The arm's whole weight must be within the joint's
    limit: beyond that no law holds it.
    """
    setup, controller = run.setup, run.setup.scenario.controller
    if with_gravity(controller.law) is None:
        return False
    truth = run.tables[topics.PLANT_TRUTH.name][tick]
    position, at_rest = truth["position"].copy(), np.zeros(setup.robot.joints)
    carried = ManipulatorModel(setup.robot, payload_kg=setup.scenario.plant.payload_kg)
    known_nm, whole_nm = (
        float(model.inverse_dynamics(position, at_rest, at_rest)[joint])
        for model in (controller.nominal_model(setup.nominal), carried)
    )
    others_nm = abs(truth["friction"][joint]) + abs(truth["disturbance"][joint])
    others_nm += abs(whole_nm - known_nm)
    error_rad = float(run.true_errors_rad[tick, joint])
    is_held = abs(whole_nm) <= float(setup.largest_torques_nm[joint])
    return bool(is_held and known_nm * error_rad < 0.0 and others_nm < abs(known_nm))
