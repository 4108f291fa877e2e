"""An arm of one joint, whose loops have closed forms, and scenarios with it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from tests.joint_laws import Policy

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


WAVE = {
    "kind": "joint_sinusoids",
    "centre_rad": [0.0],
    "terms": [{"amplitude_rad": [-0.5], "frequency_rad_s": [1.0], "phase_rad": [np.pi / 2]}],
}
"""The reference -0.5 cos(t) rad, which starts at rest."""


class BadPolicy(Policy):
    """The same policy, whose answers from 1 s on are of no use, by ``how``.

    ``raise``, ``nan``, ``shape``, or ``never``, for an answer that is never ready.
    """

    def __init__(self, model, how="raise", **more):
        super().__init__(model, **more)
        self._how = how

    def target(self, tracking):
        rows = super().target(tracking)
        if tracking.time_s < 1.0:
            return rows
        if self._how == "raise":
            raise RuntimeError("out of memory")
        if self._how == "never":
            threading.Event().wait()
        if self._how == "nan":
            rows[5, 0, 0] = np.nan
            return rows
        return rows[:, 0]


def policy_setup(
    folder: Path, *overrides: str, rows: int = 1, every: int = 1, funnel_rad: float = 0.05,
    **gains: Any,
) -> Setup:  # fmt: skip
    """Return a scenario with `Policy` along `WAVE`, and a drive loop of 100 rad/s."""
    drive = {"enabled": True, "bandwidth_rad_s": 100.0}
    controller = {
        "law": "tests.joint_laws:Policy", "gains": {"custom": {"rows": rows, **gains}},
        "every": every, "drive_feedback": drive,
    }  # fmt: skip
    more = {"controller": controller, "reference": WAVE, "duration_s": 4.0}
    return pd_setup(folder, 0.5, 0.0, 0.0, *overrides, funnel_rad=funnel_rad, **more)


def pd_setup(
    folder: Path, inertia_kg_m2: float, stiffness: float, damping: float, *overrides: str,
    funnel_rad: float = 0.05, offset_rad: float = 0.0, **sections: Any,
) -> Setup:  # fmt: skip
    """Return a scenario at rest with `Feedback` of these gains, N m/rad and N m s/rad.

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
    gains = {"stiffness": stiffness, "damping": damping}
    values = {
        "name": "one",
        "duration_s": 6.0,
        "robot": {"urdf": "arm.urdf", "initial_offset_rad": offset_rad},
        "reference": {"kind": "minimum_jerk", "waypoints": rest},
        "funnel": {
            "final_rad": funnel_rad, "overshoot_margin_rad": funnel_rad,
            "convergence_margin_rad": funnel_rad, "widest_rad": 10.0,
        },
        "controller": {"law": "tests.joint_laws:Feedback", "gains": {"custom": gains}},
        "link": {"kind": "in_process"},
        **sections,
    }  # fmt: skip
    path = folder / "one.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False))
    return load_setup(str(path), list(overrides))
