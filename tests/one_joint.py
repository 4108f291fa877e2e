"""An arm of one joint, whose loops have closed forms, and scenarios with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

_URDF = """<robot name="one"><link name="l0"/>
<joint name="j0" type="continuous"><parent link="l0"/><child link="l1"/><axis xyz="{axis}"/>
<limit effort="200" velocity="1000"/></joint>
<link name="l1"><inertial><origin xyz="{lever} 0 0"/><mass value="1"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def write_arm(
    folder: Path, inertia_kg_m2: float, *, lever_m: float = 0.0, axis: str = "0 0 1"
) -> Path:
    """Write an arm with 1 kg on a lever, with this inertia about its axis; return the file.

    By default the axis is vertical, so that gravity plays no part.
    """
    path = folder / "arm.urdf"
    own = inertia_kg_m2 - lever_m**2
    path.write_text(_URDF.format(axis=axis, lever=lever_m, i=own))
    return path


def pd_setup(
    folder: Path, inertia_kg_m2: float, stiffness: float, damping: float, *overrides: str,
    funnel_rad: float = 0.05, offset_rad: float = 0.0, **sections: Any,
) -> Setup:  # fmt: skip
    """Return a scenario at rest with a PD law of these gains, N m/rad and N m s/rad.

    Args:
        folder: where its files are written.
        inertia_kg_m2: of the link.
        stiffness: proportional gain.
        damping: derivative gain.
        overrides: as on the command line.
        funnel_rad: half its width, from the start.
        offset_rad: of the start.
        sections: further sections, which replace those from here.
    """
    write_arm(folder, inertia_kg_m2)
    rest = [{"time_s": time_s, "position_rad": [0.0]} for time_s in (0.0, 1.0)]
    gains = {"proportional": [stiffness], "integral": [0.0], "derivative": [damping]}
    values = {
        "name": "one",
        "duration_s": 6.0,
        "robot": {"urdf": "arm.urdf", "initial_offset_rad": offset_rad},
        "reference": {"kind": "minimum_jerk", "waypoints": rest},
        "funnel": {
            "final_rad": funnel_rad, "overshoot_margin_rad": funnel_rad,
            "convergence_margin_rad": funnel_rad,
        },
        "controller": {"law": "pid", "gains": {"pid": gains}},
        "link": {"kind": "in_process"},
        **sections,
    }  # fmt: skip
    path = folder / "one.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False))
    return load_setup(str(path), list(overrides))
