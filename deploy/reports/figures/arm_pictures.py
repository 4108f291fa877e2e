"""Pictures of the arm during a run."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bus_schema.arrays import Vector
from bus_schema.errors import InputError
from bus_schema.messages import topics
from bus_schema.robot_description import RobotDescription
from deploy.judge.run_data import RunData
from deploy.reports.page import Picture
from plant_emulator.physics.engines import ENGINES

if TYPE_CHECKING:
    from plant_emulator.physics.bullet.render import Rendering

_WIDTH_PX, _HEIGHT_PX = 480, 420
_OVERSAMPLING = 1.5
_RENDERED_PX = round(_OVERSAMPLING * _WIDTH_PX), round(_OVERSAMPLING * _HEIGHT_PX)


def arm_pictures(run: RunData) -> Callable[[], list[Picture] | None] | None:
    """What gives the arm at the start, in the middle and at the end of a run by one camera.

    A process of its own draws it from now on. None if nothing was recorded, or Bullet is not
    installed, or cannot draw this arm.
    """
    if not ENGINES["bullet"].is_installed:
        return None
    from plant_emulator.physics.bullet.render import Rendering

    times_s = run.times_s(topics.PLANT_TRUTH)
    if not len(times_s):
        return None
    ticks = sorted({0, len(times_s) // 2, len(times_s) - 1})
    positions = run.tables[topics.PLANT_TRUTH.name]["position"][ticks]
    return partial(_drawn, Rendering(run.setup.robot, positions, *_RENDERED_PX), times_s[ticks])


def _drawn(rendering: Rendering, times_s: Vector) -> list[Picture] | None:
    from plant_emulator.physics.bullet.render import RenderError

    try:
        pictures = rendering.pictures()
    except RenderError as error:
        print(f"warning: the report has no pictures of the arm: {error}", file=sys.stderr)
        return None
    return [Picture(float(at_s), _png(each)) for at_s, each in zip(times_s, pictures, strict=True)]


def arm_picture(robot: RobotDescription, position_rad: Vector) -> bytes:
    """A PNG file of the arm in one posture, shape (joints,).

    Raises:
        InputError: Bullet, which draws it, is not installed, or cannot draw it.
    """
    if not ENGINES["bullet"].is_installed:
        raise InputError("--picture: Bullet draws it and is not installed: pip install pybullet")
    from plant_emulator.physics.bullet.render import RenderError, Rendering

    try:
        (pixels,) = Rendering(robot, position_rad[np.newaxis], *_RENDERED_PX).pictures()
    except RenderError as error:
        raise InputError(f"--picture: {robot.path}: {error}") from error
    return _png(pixels)


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file with fewer pixels than were rendered, which smooths the renderer's edges."""
    file = io.BytesIO()
    size = (_WIDTH_PX, _HEIGHT_PX)
    Image.fromarray(pixels).resize(size, Image.Resampling.HAMMING).save(file, "PNG")
    return file.getvalue()
