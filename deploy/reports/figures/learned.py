"""What delay compensation learned of the arm over a run, beside what was to be learned.

Every function gives None where a run learned nothing of the kind.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from deploy.reports.figures import style
from deploy.reports.tables import Column, Table
from deploy.runs.judging.identified import identified, series, truth_over_time
from deploy.runs.run_data import RunData

_HEIGHT_PX = 230
_ROOM = 0.07
_TRUTH = {"color": style.INK, "width": 1.4, "dash": "dash"}


def learned_values(run: RunData) -> Table | None:
    """Final values and the truth, a row for each number."""
    found = identified(run)
    if found is None:
        return None
    names, truth = run.setup.robot.joint_names, found["truth"]
    titles = {
        "inertia_factor": "Inertia factor 1 + α", "payload_kg": "Payload (kg)",
        "lag_ms": "Actuators' lag (ms)", "coulomb_nm": "Coulomb friction (N m)",
        "viscous_nm_s": "Viscous friction (N m s)",
    }  # fmt: skip
    rows: list[tuple[str, float, float]] = []
    for key, title in titles.items():
        if isinstance(found[key], list):
            entries = zip(names, found[key], truth[key], strict=True)
            rows += [(f"{title}, {name}", value, true) for name, value, true in entries]
        elif found[key] is not None:
            rows.append((title, found[key], truth[key]))
    columns = [Column("Quantity", is_text=True), Column("At the end"), Column("Truth")]
    return Table("Final values", columns, rows)


def learned_inertia(run: RunData) -> go.Figure | None:
    """The inertia factor 1 + α."""
    truth = truth_over_time(run.setup).inertia_factor
    return _of_the_arm(run, "inertia_factor", "1 + α", [(0.0, truth)])


def learned_payload(run: RunData) -> go.Figure | None:
    """Mass at the tip, which scheduled faults may change."""
    return _of_the_arm(run, "payload_kg", "kg", truth_over_time(run.setup).payload_kg)


def learned_lag(run: RunData) -> go.Figure | None:
    """The actuators' time constant."""
    return _of_the_arm(run, "lag_ms", "ms", [(0.0, truth_over_time(run.setup).lag_ms)])


def learned_coulomb(run: RunData) -> go.Figure | None:
    """Coulomb friction of every joint."""
    return _of_joints(run, "coulomb_nm", "N m", truth_over_time(run.setup).coulomb_nm)


def learned_viscous(run: RunData) -> go.Figure | None:
    """Viscous friction of every joint."""
    return _of_joints(run, "viscous_nm_s", "N m s", truth_over_time(run.setup).viscous_nm_s)


def _of_the_arm(
    run: RunData, name: str, unit: str, steps: list[tuple[float, float]]
) -> go.Figure | None:
    values = series(run, name)
    if values is None:
        return None
    times_s = run.times_s(topics.CONTROL_STATUS)
    end_s = float(times_s[-1])
    known = [(at_s, true) for at_s, true in steps if at_s <= end_s]
    x, y = zip(*known, (end_s, known[-1][1]), strict=True)
    figure = go.Figure([
        style.line(times_s, values, style.palette(0), "believed"),
        go.Scatter(x=x, y=y, name="truth", mode="lines", line={**_TRUTH, "shape": "hv"}),
    ])  # fmt: skip
    style.apply(figure, _HEIGHT_PX)
    figure.update_xaxes(title_text="time (s)")
    figure.update_yaxes(title_text=unit, range=_room(values, np.array(y)))
    return figure


def _of_joints(run: RunData, name: str, unit: str, truth: Vector) -> go.Figure | None:
    values: Matrix | None = series(run, name)
    if values is None:
        return None
    times_s, names = run.times_s(topics.CONTROL_STATUS), run.setup.robot.joint_names
    ends_s = np.array([times_s[0], times_s[-1]])
    figure = style.joint_rows(names, unit)
    for joint, joint_name in enumerate(names):
        believed = style.line(times_s, values[:, joint], style.palette(joint), joint_name)
        true = go.Scatter(x=ends_s, y=np.full(2, truth[joint]), name="truth", mode="lines")
        figure.add_traces([believed, true.update(line=_TRUTH)], rows=joint + 1, cols=1)
        figure.update_yaxes(range=_room(values[:, joint], truth[joint]), row=joint + 1)
    return figure


def _room(values: Vector, truth: Vector | float) -> list[float]:
    """A vertical range with all of a line and of the truth well inside."""
    lowest = float(min(np.nanmin(values), np.min(truth)))
    highest = float(max(np.nanmax(values), np.max(truth)))
    room = _ROOM * (highest - lowest) or _ROOM
    return [lowest - room, highest + room]
