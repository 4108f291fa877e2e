"""Parameters that delay compensation and networks learned over a run, beside the truth.

Functions that draw give None where a run learned nothing of the kind.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from deploy.judge.findings.identified import identified, series, truth_of
from deploy.judge.run_data import RunData, stamps_s
from deploy.reports.figures import style
from deploy.reports.tables import Column, Table
from deploy.study.comparison.compared_runs import ComparedRuns
from plant_emulator.faults.arm_faults import payload_steps

_ROOM = 0.07
_POINTS = 4000
_TRUTH = {**style.SHOULD_BE, "shape": "hv"}
_UNITS = {
    "inertia_factor": ("Inertia factor 1 + α", ""),
    "payload_kg": ("Payload", "kg"),
    "lag_ms": ("Actuators' lag", "ms"),
    "coulomb_nm": ("Coulomb friction", "N m"),
    "viscous_nm_s": ("Viscous friction", "N m s"),
}
"""Name and unit of what is learned, by its key in a summary."""


def learned_values(run: RunData) -> Table | None:
    """Final values and the truth, a row for each number."""
    found = identified(run)
    if found is None:
        return None
    names, truth = run.setup.robot.joint_names, found["truth"]
    rows: list[tuple[str, float, float]] = []
    for key, (name, unit) in _UNITS.items():
        title = Column(name, unit).title
        if isinstance(found[key], list):
            entries = zip(names, found[key], truth[key], strict=True)
            rows += [(f"{title}, {joint}", value, true) for joint, value, true in entries]
        elif found[key] is not None:
            rows.append((title, found[key], truth[key]))
    columns = [Column("Quantity", is_text=True), Column("At the end"), Column("Truth")]
    return Table("Final values", columns, rows)


def learned_over_time(run: RunData, key: str) -> go.Figure | None:
    """One of the learned numbers over time, a row for each joint where each has its own."""
    values = series(run, key)
    if values is None:
        return None
    truth, (title, unit) = truth_of(run.setup)[key], _UNITS[key]
    if values.ndim > 1:
        names, steps = run.setup.robot.joint_names, [[(0.0, value)] for value in truth]
    else:
        names, steps = (title,), [truth if key == "payload_kg" else [(0.0, truth)]]
    times_s = run.times_s(topics.CONTROL_STATUS)
    end_s = float(times_s[-1])
    figure = style.joint_rows(names, unit or "1 + α")
    rows = zip(names, values.reshape(len(values), -1).T, steps, strict=True)
    for row, (name, believed, its_steps) in enumerate(rows, start=1):
        known = [(at_s, true) for at_s, true in its_steps if at_s <= end_s]
        x, y = zip(*known, (end_s, known[-1][1]), strict=True)
        true = go.Scatter(x=x, y=y, name="truth", mode="lines", line=_TRUTH)
        line = style.line(times_s, believed, style.palette(row - 1), name)
        figure.add_traces([true, line], rows=row, cols=1)
        figure.update_yaxes(range=_room(believed, np.array(y)), row=row)
    return figure


def _room(values: Vector, truth: Vector) -> list[float]:
    """A vertical range with all of a line and of the truth well inside."""
    lowest = float(min(np.nanmin(values), np.min(truth)))
    highest = float(max(np.nanmax(values), np.max(truth)))
    room = _ROOM * (highest - lowest) or _ROOM
    return [lowest - room, highest + room]


def network_output(runs: ComparedRuns) -> go.Figure | None:
    """Output of the first network and the dynamics it stands in for; None without one."""
    drawings = (_network_output(run.data) for run in runs.drawn)
    return next((figure for figure in drawings if figure is not None), None)


def _network_output(run: RunData) -> go.Figure | None:
    figure = style.joint_series(run, topics.CONTROL_STATUS, "network_output", "N m")
    if figure is None:
        return None
    times_s, truth = unknown_dynamics_nm(run, _POINTS)
    late = times_s >= run.setup.scenario.metrics.from_s
    for row, values in enumerate(truth.T, start=1):
        trace = style.line(times_s, values, style.MUTED, "true dynamics").update(
            line=style.SHOULD_BE
        )
        figure.add_trace(trace, row=row, col=1)
        if late.any():
            lowest, highest = values[late].min(), values[late].max()
            room = 0.3 * (highest - lowest) + 1.0
            figure.update_yaxes(range=[lowest - room, highest + room], row=row)
    figure.data = figure.data[::-1]  # what is drawn first lies below
    return figure


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
