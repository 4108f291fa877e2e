"""The command `ros2-control`: what ros2_control needs to close the loop around a scenario's arm."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from bus_schema.recording.atomic_files import write_whole
from bus_schema.view.arm_view import description
from deploy.cli.options import Overrides, ScenarioArgument
from deploy.input_error import InputError
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

CONTROLLER = "joint_trajectory_controller"


def ros2_control(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder; by default <scenario>_ros2_control.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files there that differ.")
    ] = False,
) -> None:
    """Write the arm's URDF with its ros2_control element, and a controllers.yaml for it."""
    setup = load_setup(scenario, overrides or [])
    folder = out or Path(f"{setup.scenario.name}_ros2_control")
    texts = {
        folder / "robot.urdf": description(setup.robot),
        folder / "controllers.yaml": yaml.safe_dump(controllers_of(setup), sort_keys=False),
    }
    try:
        if not overwrite:
            _require_nothing_else(texts)
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            write_whole(file, text)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written: {error.strerror}") from error
    print(folder)


def _require_nothing_else(texts: Mapping[Path, str]) -> None:
    """Check that no file is there with another text, which may be somebody's work."""
    for file, text in texts.items():
        if file.exists() and file.read_bytes() != text.encode():
            raise InputError(
                f"{file}: is there already and differs from what would be written: must be moved"
                " away, or give --overwrite or another --out"
            )


def controllers_of(setup: Setup) -> dict[str, Any]:
    """Parameters for ``ros2_control_node``: a trajectory controller that commands torques.

    Its gains are those of a loop that is critically damped at ``controller.drive_feedback``'s
    bandwidth, around the inertia that each joint feels.
    """
    names, gains = setup.robot.joint_names, setup.tuned_drive
    tuned = zip(names, gains.stiffness_nm_rad, gains.damping_nm_s, strict=True)
    return {
        "controller_manager": {
            "ros__parameters": {
                "use_sim_time": True,
                "update_rate": round(setup.scenario.rate_hz),
                CONTROLLER: {"type": f"{CONTROLLER}/JointTrajectoryController"},
            }
        },
        CONTROLLER: {
            "ros__parameters": {
                "joints": list(names),
                "command_interfaces": ["effort"],
                "state_interfaces": ["position", "velocity"],
                "gains": {
                    name: {"p": float(f"{stiffness:.6g}"), "i": 0.0, "d": float(f"{damping:.6g}")}
                    for name, stiffness, damping in tuned
                },
            }
        },
    }
