"""What a neural network learned, against the dynamics it stands in for."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from deploy.comparison.comparison import Comparison
from deploy.reports.figures import style
from deploy.runs.run_data import RunData, stamps_s
from plant_emulator.faults.arm_faults import payload_steps

_POINTS = 4000


def network_output(run: RunData) -> go.Figure | None:
    """Output of the network and the dynamics it stands in for; None for a law without one."""
    figure = style.joint_series(run, topics.CONTROL_STATUS, "network_output", "N m")
    if figure is None:
        return None
    times_s, truth = unknown_dynamics_nm(run, _POINTS)
    late = times_s >= run.setup.scenario.metrics.from_s
    for row, values in enumerate(truth.T, start=1):
        trace = style.line(times_s, values, "rgba(123,135,148,0.55)", "true dynamics", 4.5)
        figure.add_trace(trace, row=row, col=1)
        if late.any():
            lowest, highest = values[late].min(), values[late].max()
            room = 0.3 * (highest - lowest) + 1.0
            figure.update_yaxes(range=[lowest - room, highest + room], row=row)
    figure.data = figure.data[::-1]  # what is drawn first lies below
    return figure


def first_network_output(comparison: Comparison) -> go.Figure | None:
    """The same of the first law with a network."""
    drawings = (network_output(run.data) for run in comparison.drawn)
    return next((figure for figure in drawings if figure is not None), None)


def unknown_dynamics_nm(run: RunData, points: int) -> tuple[Vector, Matrix]:
    """M(q) q̈_d + C(q, q̇) q̇ + G(q) + friction + disturbance at evenly spaced ticks.

    With the true arm's M, C and G, what it carries included, and the reference acceleration q̈_d.

    Args:
        run: the run.
        points: how many at most; a tick costs as much as all else that is drawn of it.

    Returns:
        Times (s), shape (ticks,), and torques, shape (ticks, joints).
    """
    setup = run.setup
    table = run.tables[topics.PLANT_TRUTH.name]
    truth = table[:: max(1, -(-len(table) // points))]
    steps = payload_steps(setup.scenario.plant.payload_kg, setup.scenario.faults)
    models = [ManipulatorModel(setup.robot, payload_kg=payload_kg) for _, payload_kg in steps]
    times_s = stamps_s(truth)
    carried = np.searchsorted([at_s for at_s, _ in steps], times_s, side="right") - 1
    position, velocity = truth["position"], truth["velocity"]
    torque = truth["friction"] + truth["disturbance"]
    wanted, rate, acceleration = np.empty((3, setup.robot.joints))
    for tick, time_s in enumerate(times_s):
        setup.reference.evaluate(float(time_s), wanted, rate, acceleration)
        model = models[carried[tick]]
        torque[tick] += model.inverse_dynamics(position[tick], velocity[tick], acceleration)
    return times_s, np.asarray(torque)
