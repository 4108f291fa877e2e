"""Arms made at random: serial chains of 3 to 7 joints, without tuned gains."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel, spread_positions

_AXES = ("1 0 0", "0 1 0", "0 0 1")
_LINK = """<link name="link{number}"><inertial><mass value="{mass:.4g}"/>
<origin xyz="{centre}"/><inertia ixx="{across:.4g}" iyy="{across:.4g}" izz="{along:.4g}"
 ixy="0" ixz="0" iyz="0"/></inertial></link>"""
_JOINT = """<joint name="joint{number}" type="revolute"><parent link="{parent}"/>
<child link="link{number}"/><origin xyz="0 0 {before:.4g}"/><axis xyz="{axis}"/>
<limit lower="-{range:.3g}" upper="{range:.3g}" effort="{effort:.4g}" velocity="{speed:.3g}"/>
</joint>"""


def write_random_arm(folder: Path, seed: int) -> Path:
    """Write the URDF file of an arm.

    Links are rods that get lighter and shorter outwards; no axis is that of the joint before. Every
    joint has 1.5 to 3 times the torque that holds the arm up in its worst posture, and at least a
    twentieth of the strongest joint's.

    Args:
        folder: where to.
        seed: another one gives another arm.
    """
    random = np.random.default_rng([2026, seed])
    joints = int(random.integers(3, 8))
    lengths = 0.35 * random.uniform(0.5, 1.5, joints) * 0.8 ** np.arange(joints)
    masses = 10 ** random.uniform(-0.3, 1.2) * random.uniform(0.6, 1.4, joints)
    masses *= random.uniform(0.5, 0.8) ** np.arange(joints)
    axes = [int(random.integers(3))]
    while len(axes) < joints:
        axes.append((axes[-1] + int(random.integers(1, 3))) % 3)
    ranges, speeds = random.uniform(1.5, 3.0, joints), random.uniform(1.5, 4.0, joints)
    factors, efforts = random.uniform(1.5, 3.0, joints), np.full(joints, 1.0)
    file = folder / f"random_{seed}.urdf"
    for _ in range(2):  # the second time with torques for what the first one weighs
        parts = [f'<robot name="random_{seed}"><link name="base"/>']
        for i, (mass, length) in enumerate(zip(masses, lengths, strict=True)):
            thick, rod = 0.15 * length, mass * length**2 / 12.0
            x, y = 0.2 * thick * random.uniform(-1.0, 1.0, 2)
            centre = f"{x:.4g} {y:.4g} {0.5 * length:.4g}"
            across, along = rod + 0.25 * mass * thick**2, 0.5 * mass * thick**2
            parts.append(_LINK.format(
                number=i, mass=mass, centre=centre, across=across, along=along
            ))  # fmt: skip
            parts.append(_JOINT.format(
                number=i, parent=f"link{i - 1}" if i else "base", axis=_AXES[axes[i]],
                before=lengths[i - 1] if i else 0.0, range=ranges[i], effort=efforts[i],
                speed=speeds[i],
            ))  # fmt: skip
        file.write_text("".join(parts) + "</robot>", encoding="utf-8")
        model, robot = ManipulatorModel(load_robot(file)), load_robot(file)
        held = np.abs([model.gravity(each) for each in spread_positions(robot)]).max(axis=0)
        efforts = factors * np.maximum(held, 0.05 * held.max())
    return file
