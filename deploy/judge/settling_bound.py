"""The bound on a law's settling time on the arm that it is tried on."""

from __future__ import annotations

from bus_schema.arrays import Vector
from controller.manipulator_model import ManipulatorModel, spread_positions
from deploy.scenario.setup import Setup

_largest_inertias: dict[tuple[str, float, bytes], float] = {}
"""By arm, payload and weights: the runs of a study mostly share them."""


def settling_bound_s(setup: Setup) -> float | None:
    """The law's bound for this arm with its payload, s; None for a law that has none.

    The largest inertia is the largest found in positions spread over all joint ranges, not only on
    the reference: one bound for every start.
    """
    robot, payload_kg = setup.robot, setup.scenario.plant.payload_kg

    def largest_inertia(weights: Vector) -> float:
        arm = (robot.text, payload_kg, weights.tobytes())
        if arm not in _largest_inertias:
            model = ManipulatorModel(robot, payload_kg=payload_kg)
            _largest_inertias[arm] = model.largest_inertia(spread_positions(robot), weights)
        return _largest_inertias[arm]

    return setup.scenario.controller.settling_bound_s(setup.gains, largest_inertia)
