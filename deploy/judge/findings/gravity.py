"""Sag: a joint that its own weight moves away, as its law has no term for gravity."""

from __future__ import annotations

import numpy as np

from bus_schema.messages import topics
from controller.laws import LAWS
from deploy.judge.run_data import RunData


def with_gravity(law: str) -> str | None:
    """Return the law that has the gravity term which `law` lacks; None if that is not known."""
    return LAWS[law].with_gravity if law in LAWS else None


def sags(run: RunData, joint: int, tick: int) -> bool:
    """Whether gravity, which the law does not know, moves a joint away from its reference.

    It does if the error has the direction of the weight, and the weight exceeds friction and
    disturbance, the other torques that the law does not know. It must be within the joint's limit:
    beyond that no law holds it.
    """
    controller = run.setup.scenario.controller
    if with_gravity(controller.law) is None:
        return False
    truth = run.tables[topics.PLANT_TRUTH.name][tick]
    at_rest = np.zeros(run.setup.robot.joints)
    model = controller.nominal_model(run.setup.nominal)
    holding_nm = float(model.inverse_dynamics(truth["position"].copy(), at_rest, at_rest)[joint])
    others_nm = abs(truth["friction"][joint]) + abs(truth["disturbance"][joint])
    error_rad = float(run.true_errors_rad[tick, joint])
    largest_nm = float(run.setup.largest_torques_nm[joint])
    return bool(holding_nm * error_rad < 0.0 and others_nm < abs(holding_nm) <= largest_nm)
