"""Pictures of the arm during a run."""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from bus_schema.robot_description import RobotDescription
from deploy.input_error import InputError
from deploy.reports.page import Picture
from deploy.runs.run_data import RunData
from plant_emulator.physics.engines import ENGINES

if TYPE_CHECKING:
    from plant_emulator.physics.bullet.camera import ArmCamera

_WIDTH_PX, _HEIGHT_PX = 480, 420
_OVERSAMPLING = 1.5
_RENDERED_PX = round(_OVERSAMPLING * _WIDTH_PX), round(_OVERSAMPLING * _HEIGHT_PX)


def arm_pictures(run: RunData) -> Callable[[], list[Picture]] | None:
    """What renders the arm at the start, in the middle and at the end of a run by one camera.

    Any thread may call it; the arm is loaded here, where nothing else prints meanwhile: what is
    printed while Bullet loads is lost. None if nothing was recorded, or Bullet is not installed.
    """
    if not ENGINES["bullet"].is_installed:
        return None
    from plant_emulator.physics.bullet.camera import ArmCamera

    times_s = run.times_s(topics.PLANT_TRUTH)
    if not len(times_s):
        return None
    ticks = sorted({0, len(times_s) // 2, len(times_s) - 1})
    positions = run.tables[topics.PLANT_TRUTH.name]["position"][ticks]
    return partial(_rendered, ArmCamera(run.setup.robot), times_s[ticks], positions)


def _rendered(camera: ArmCamera, times_s: Vector, positions: Matrix) -> list[Picture]:
    """The arm at each time, and the end of the camera."""
    with closing(camera):
        extent = camera.extent(positions)
        rendered = (camera.render(position, *_RENDERED_PX, extent) for position in positions)
        with ThreadPoolExecutor(max_workers=1) as executor:  # one is written, the next rendered
            files = list(executor.map(_png, rendered))
    return [Picture(float(time_s), png) for time_s, png in zip(times_s, files, strict=True)]


def arm_picture(robot: RobotDescription, position_rad: Vector) -> bytes:
    """A PNG file of the arm in one posture, shape (joints,).

    Raises:
        InputError: Bullet, which draws it, is not installed.
    """
    if not ENGINES["bullet"].is_installed:
        raise InputError("--picture: Bullet draws it and is not installed: pip install pybullet")
    from plant_emulator.physics.bullet.camera import ArmCamera

    with closing(ArmCamera(robot)) as camera:
        return _png(camera.render(position_rad, *_RENDERED_PX))


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file with fewer pixels than were rendered, which smooths the renderer's edges."""
    file = io.BytesIO()
    size = (_WIDTH_PX, _HEIGHT_PX)
    Image.fromarray(pixels).resize(size, Image.Resampling.HAMMING).save(file, "PNG")
    return file.getvalue()
