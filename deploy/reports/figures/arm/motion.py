"""The arm along its run: a skeleton that moves, and where the reference has it."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.reports.figures import style
from deploy.reports.figures.arm.space import still_space
from deploy.reports.page import Motion
from deploy.runs.run_data import RunData, stamps_s

_FRAMES = 400
_HEIGHT_PX = 480
_GHOST = {"color": style.MUTED, "width": 18}


def arm_motion(run: RunData) -> Motion | None:
    """The arm from joint to joint as it moved, before a ghost of it on the reference.

    None if nothing was recorded.
    """
    truth = run.tables[topics.PLANT_TRUTH.name]
    if not len(truth):
        return None
    shown = np.unique(np.linspace(0, len(truth) - 1, _FRAMES).round().astype(int))
    times_s, robot = stamps_s(truth[shown]), run.setup.robot
    wanted = sample_positions(run.setup.reference, times_s, robot.joints)
    model = ManipulatorModel(robot)
    ghost, arm = (skeletons(model, each) for each in (wanted, truth["position"][shown]))
    figure = go.Figure([
        _skeleton(ghost[0], "reference", "lines", line=_GHOST, opacity=0.35),
        _skeleton(arm[0], "true", "lines+markers", line={"color": style.palette(0), "width": 7},
                  marker={"size": 4, "color": style.INK}),
    ])  # fmt: skip
    style.apply(figure, _HEIGHT_PX, legend=True)
    figure.update_layout(
        scene=still_space(np.concatenate([ghost, arm])),
        margin={"l": 0, "r": 0, "b": 0},
        legend={"y": 0},
    )
    return Motion(figure, times_s, np.stack([ghost, arm], axis=1))


def skeletons(model: ManipulatorModel, positions: Matrix) -> NDArray[np.float64]:
    """Bones of the arm in each posture as one broken line each, shape (postures, points, 3), m.

    NaN follows each bone, the last of which ends at the tip.
    """
    bones = np.array([model.skeleton(position) for position in positions])
    gaps = np.full_like(bones[:, :, :1], np.nan)
    return np.concatenate([bones, gaps], axis=2).reshape(len(bones), -1, 3)


def _skeleton(points: Matrix, name: str, mode: str, **look: object) -> go.Scatter3d:
    x, y, z = points.T
    return go.Scatter3d(x=x, y=y, z=z, name=name, mode=mode, hoverinfo="skip", **look)
