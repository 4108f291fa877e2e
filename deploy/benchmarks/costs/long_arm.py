"""An arm with as many joints as a benchmark asks for, and a scenario for it."""

from __future__ import annotations

from pathlib import Path

from deploy.scenario.yaml_files import to_yaml

_LENGTH_M = 0.12
_MASS_KG, _TAPER = 3.0, 0.85
_INERTIA_KG_M2 = 0.02
_EFFORT_NM = 500.0
_REACH_RAD = 2.9


def write_long_arm(folder: Path, joints: int) -> Path:
    """Write URDF and scenario of a serial arm whose joints turn about z and y by turns.

    Args:
        folder: where.
        joints: at least 1.

    Returns:
        The scenario file.
    """
    urdf = folder / "long_arm.urdf"
    urdf.write_text(_urdf(joints))
    sinusoid = {"amplitude_rad": 0.2, "frequency_rad_s": 0.7}
    scenario = {
        "name": f"long_arm_{joints}",
        "duration_s": 5.0,
        "robot": {"urdf": str(urdf), "initial_offset_rad": 0.05},
        "reference": {"kind": "joint_sinusoids", "centre_rad": 0.1, "terms": [sinusoid]},
    }
    file = folder / "long_arm.yaml"
    file.write_text(to_yaml(scenario), encoding="utf-8")
    return file


def _urdf(joints: int) -> str:
    parts = ['<robot name="long_arm">', _link(0)]
    for index in range(1, joints + 1):
        parts.append(_link(index))
        parts.append(
            f'<joint name="joint_{index}" type="revolute">'
            f'<parent link="link_{index - 1}"/><child link="link_{index}"/>'
            f'<origin xyz="0 0 {_LENGTH_M}"/><axis xyz="{"0 0 1" if index % 2 else "0 1 0"}"/>'
            f'<limit lower="-{_REACH_RAD}" upper="{_REACH_RAD}" effort="{_EFFORT_NM}"'
            ' velocity="10"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def _link(index: int) -> str:
    size = _TAPER**index
    inertia = _INERTIA_KG_M2 * size
    return (
        f'<link name="link_{index}"><inertial><origin xyz="0 0 {_LENGTH_M / 2}"/>'
        f'<mass value="{_MASS_KG * size}"/><inertia ixx="{inertia}" iyy="{inertia}"'
        f' izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
