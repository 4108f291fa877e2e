"""Write files for ROS 2: its package of messages, and an arm with its controllers."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from bus_schema.errors import InputError
from bus_schema.messages.types import PACKAGE
from bus_schema.recording.atomic_files import write_whole
from bus_schema.view.arm_view import description
from deploy.cli.parts.options import Overrides, ScenarioArgument
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

CONTROLLER = "joint_trajectory_controller"
_PACKAGE_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>Messages of funnel-hil.</description>
  <maintainer email="noreply@example.org">funnel-hil</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>builtin_interfaces</depend>
  <depend>std_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
_CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(builtin_interfaces REQUIRED)
find_package(std_msgs REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}}
{messages}
  DEPENDENCIES builtin_interfaces std_msgs
)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def ros2_control(
    scenario: ScenarioArgument = "paper_arm",
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder; by default <scenario>_ros2_control.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace existing files that differ.")
    ] = False,
) -> None:
    """Write the arm's URDF with a ros2_control element, and a controllers.yaml."""
    setup = load_setup(scenario, overrides or [])
    folder = out or Path(f"{setup.scenario.name}_ros2_control")
    texts = {
        folder / "robot.urdf": description(setup.robot),
        folder / "controllers.yaml": yaml.safe_dump(controllers_of(setup), sort_keys=False),
    }
    if not overwrite:
        _require_nothing_else(texts)
    _write_all(texts)
    print(folder)


def _require_nothing_else(texts: Mapping[Path, str]) -> None:
    """Refuse to replace a file with other contents, which someone may have edited."""
    for file, text in texts.items():
        if file.is_file() and file.read_bytes() != text.encode():
            raise InputError(
                f"{file}: exists and differs from the new file: must be moved"
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


def ros_package(
    folder: Annotated[
        Path, typer.Argument(help="Parent folder of the package, such as ~/ros2_ws/src.")
    ],
) -> None:
    """Write the message types of funnel-hil as a ROS 2 package for colcon."""
    package = folder / PACKAGE
    source = resources.files("bus_schema.messages").joinpath("msg")
    names = sorted(file.name for file in source.iterdir() if file.name.endswith(".msg"))
    listed = "\n".join(f'  "msg/{name}"' for name in names)
    texts = {f"msg/{name}": source.joinpath(name).read_text(encoding="utf-8") for name in names} | {
        "package.xml": _PACKAGE_XML.format(package=PACKAGE, version=version("funnel-hil")),
        "CMakeLists.txt": _CMAKE.format(package=PACKAGE, messages=listed),
    }
    _write_all({package / name: text for name, text in texts.items()})
    typer.echo(package)


def _write_all(texts: Mapping[Path, str]) -> None:
    for file, text in texts.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, text)
        except OSError as error:
            raise InputError(f"{file.parent}: cannot be written: {error.strerror}") from error


app = typer.Typer(
    no_args_is_help=True, add_completion=False, help=__doc__, pretty_exceptions_enable=False
)
app.command("package")(ros_package)
app.command("control")(ros2_control)
