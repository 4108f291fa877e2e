"""Pictures of the arm during a run, as PNG files."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages import topics
from deploy.reports.page import Picture
from deploy.runs.run_data import RunData
from plant_emulator.arm.pybullet_arm import PybulletArm

_WIDTH_PX, _HEIGHT_PX = 480, 420
_OVERSAMPLING = 2


def arm_pictures(run: RunData) -> list[Picture] | None:
    """The arm at the start, in the middle and at the end of a run, seen by the same camera.

    None if nothing was recorded.
    """
    times_s = run.times_s(topics.PLANT_TRUTH)
    if not len(times_s):
        return None
    ticks = sorted({0, len(times_s) // 2, len(times_s) - 1})
    positions = run.tables[topics.PLANT_TRUTH.name]["position"][ticks]
    arm = PybulletArm(run.setup.robot, run.setup.grid.substep_s)
    try:
        extent = arm.extent(positions)
        pictures = [
            arm.render(position, _OVERSAMPLING * _WIDTH_PX, _OVERSAMPLING * _HEIGHT_PX, extent)
            for position in positions
        ]
    finally:
        arm.close()
    return [
        Picture(float(times_s[tick]), encode_png(_shrink(picture)))
        for tick, picture in zip(ticks, pictures, strict=True)
    ]


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """An RGB image, shape (height, width, 3), as PNG (ISO/IEC 15948, unfiltered scanlines)."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + body + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)


def _shrink(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Average over squares of pixels, which smooths the renderer's edges."""
    height, width, channels = pixels.shape
    n = _OVERSAMPLING
    squares = pixels.reshape(height // n, n, width // n, n, channels)
    smooth: NDArray[np.uint8] = squares.mean(axis=(1, 3)).astype(np.uint8)
    return smooth
