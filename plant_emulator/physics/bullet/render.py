"""Pictures of an arm by a separate process: Bullet's mesh readers crash on hostile files."""

from __future__ import annotations

import pickle
import sys
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.limited_process import (
    LimitedProcess,
    LimitedProcessError,
    limit_this_process,
)


class RenderError(Exception):
    """No picture was drawn; the message says why."""


class Rendering:
    """Pictures that a separate process draws in the background.

    Args:
        robot: description of the arm.
        positions: joint positions of each picture, rad, shape (pictures, joints).
        width_px: width of the pictures.
        height_px: height of the pictures.
    """

    def __init__(
        self, robot: RobotDescription, positions: Matrix, width_px: int, height_px: int
    ) -> None:
        self.robot, self.positions = robot, positions
        self._shape = len(positions), height_px, width_px, 3
        order = pickle.dumps((robot, positions, width_px, height_px))
        self._process = LimitedProcess(__name__, order)

    def pictures(self) -> NDArray[np.uint8]:
        """Return the pictures on white by one camera, shape (pictures, height, width, 3), RGB.

        Raises:
            RenderError: the process crashed, or exceeded its limits.
        """
        try:
            pixels = self._process.answer()
        except LimitedProcessError as error:
            what = "Bullet cannot draw the arm: a mesh file is damaged or too large"
            raise RenderError(f"{what} ({error})") from error
        return np.frombuffer(pixels, np.uint8).reshape(self._shape)


def main() -> None:
    """Draw the pictures that standard input requests, on standard output, within limits."""
    limit_this_process(cpu_s=6)
    from plant_emulator.physics.bullet.camera import ArmCamera

    robot, positions, width_px, height_px = pickle.load(sys.stdin.buffer)
    with closing(ArmCamera(robot)) as camera:
        extent = camera.extent(positions)
        for position in positions:
            sys.stdout.buffer.write(camera.render(position, width_px, height_px, extent).tobytes())


if __name__ == "__main__":
    main()
