"""An arm as lines in space: from each link's frame to those of the links that it carries."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.robot_description import RobotDescription
from bus_schema.view.link_poses import LinkPoses, Poses

Lines = dict[str, list[float | None]]
"""Coordinates x, y and z of points, m; None between lines. The last line ends at the tip."""


class ArmLines:
    """Where the lines of an arm are.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._poses = LinkPoses(robot)
        attached = {each.child: each.parent for each in (*self._poses.fixed, *self._poses.moving)}
        self._parents = _parents_first(attached)
        tip = robot.tip_link
        self._drawn = sorted(self._parents, key=lambda link: link == tip)

    def lines(self, position: Vector) -> Lines | None:
        """The lines at a position of the joints, shape (joints,); None where that is not finite."""
        if not np.isfinite(position).all():
            return None
        places = self._places(position)
        lines: Lines = {"x": [], "y": [], "z": []}
        for link in self._drawn:
            parent = self._parents[link]
            for axis, name in enumerate("xyz"):
                ends = (
                    round(float(places[parent][axis, 3]), 5),
                    round(float(places[link][axis, 3]), 5),
                )
                lines[name] += [None, *ends] if lines[name] else ends
        return lines

    def _places(self, position: Vector) -> dict[str, Matrix]:
        """Placement of each link in the base's frame, shape (4, 4)."""
        poses = self._poses
        own = dict(zip((each.child for each in poses.fixed), poses.fixed_poses, strict=True))
        moving = poses.moving_poses(position)
        own |= dict(zip((each.child for each in poses.moving), moving, strict=True))
        places = {poses.root: np.eye(4)}
        for link, parent in self._parents.items():
            places[link] = places[parent] @ _matrix(own[link])
        return places


def _parents_first(attached: dict[str, str]) -> dict[str, str]:
    """Links and what carries them, so ordered that each comes after the one that carries it."""

    def depth(link: str) -> int:
        return 1 + depth(attached[link]) if link in attached else 0

    return {link: attached[link] for link in sorted(attached, key=depth)}


def _matrix(pose: Poses) -> Matrix:
    """A placement from a translation and a unit quaternion."""
    (x, y, z), w = pose[3:6], pose[6]
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    placement = np.eye(4)
    placement[:3, :3], placement[:3, 3] = turn, pose[:3]
    return placement
