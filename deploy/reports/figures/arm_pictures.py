"""Pictures of the arm during a run."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, needs_extra
from bus_schema.messages import topics
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.judge.run_data import RunData
from deploy.reports.figures import style
from deploy.reports.page import Picture
from plant_emulator.physics.engines import ENGINES

if TYPE_CHECKING:
    from plant_emulator.physics.bullet.render import Rendering

_WIDTH_PX, _HEIGHT_PX = 480, 420
_OVERSAMPLING = 1.5
_RENDERED_PX = round(_OVERSAMPLING * _WIDTH_PX), round(_OVERSAMPLING * _HEIGHT_PX)
_RIGHT_AND_DOWN = np.array([[0.81, 0.59, 0.0], [0.21, -0.29, -0.93]])
"""Axes of a skeleton's picture in the base frame, as Bullet's camera sees the arm."""
_FILLED, _BONE_PX, _JOINT_PX = 0.8, 16, 14


def arm_pictures(run: RunData) -> Callable[[], list[Picture] | None] | None:
    """Start drawing the arm at start, middle and end of a run; return what waits for the pictures.

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
        pictures = _pixels(rendering)
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
        raise InputError(f"--picture: {needs_extra('pybullet', 'bullet')}, which draws it")
    from plant_emulator.physics.bullet.render import RenderError, Rendering

    try:
        (pixels,) = _pixels(Rendering(robot, position_rad[np.newaxis], *_RENDERED_PX))
    except RenderError as error:
        raise InputError(f"--picture: {robot.path}: {error}") from error
    return _png(pixels)


def _pixels(rendering: Rendering) -> NDArray[np.uint8]:
    """Render by Bullet; an arm without shapes that it can draw becomes a skeleton."""
    rendered = rendering.pictures()
    if (rendered < 255).any():
        return rendered
    model = ManipulatorModel(rendering.robot)
    bones = np.array(list(map(model.skeleton, rendering.positions))) @ _RIGHT_AND_DOWN.T
    lower, upper = bones.min(axis=(0, 1, 2)), bones.max(axis=(0, 1, 2))
    scale = _FILLED * np.min(np.array(_RENDERED_PX) / np.maximum(upper - lower, 1e-6))
    return np.array([_skeleton(each) for each in scale * (bones - (lower + upper) / 2)])


def _skeleton(bones_px: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Lines from joint to joint; ends of bones relative to the middle, shape (bones, 2, 2), px."""
    image = Image.new("RGB", _RENDERED_PX, "white")
    draw, ends = ImageDraw.Draw(image), bones_px + np.array(_RENDERED_PX) / 2
    for bone in ends:
        draw.line(list(map(tuple, bone)), style.palette(0), _BONE_PX)
    for joint in ends.reshape(-1, 2):
        draw.circle(tuple(joint), _JOINT_PX, style.INK)
    return np.asarray(image)


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file with fewer pixels than were rendered, which smooths the renderer's edges."""
    file = io.BytesIO()
    size = (_WIDTH_PX, _HEIGHT_PX)
    Image.fromarray(pixels).resize(size, Image.Resampling.HAMMING).save(file, "PNG")
    return file.getvalue()
