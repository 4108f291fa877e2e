"""The command `ros-package`: our message types as a package that colcon builds."""

from __future__ import annotations

from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from bus_schema.messages.types import PACKAGE
from bus_schema.recording.atomic_files import write_whole
from deploy.input_error import InputError

_DEPENDENCIES = ("builtin_interfaces", "std_msgs")
_PACKAGE_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>Messages of funnel-hil.</description>
  <maintainer email="noreply@example.org">funnel-hil</maintainer>
  <license>{license}</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depends}
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
{found}
rosidl_generate_interfaces(${{PROJECT_NAME}}
{messages}
  DEPENDENCIES {dependencies}
)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def ros_package(
    folder: Annotated[Path, typer.Argument(help="Where to put it, such as ~/ros2_ws/src.")],
) -> None:
    """Write our message types as a ROS 2 package, for colcon to build."""
    package = folder / PACKAGE
    messages = [
        file
        for file in resources.files("bus_schema.messages").joinpath("msg").iterdir()
        if file.name.endswith(".msg")
    ]
    try:
        (package / "msg").mkdir(parents=True, exist_ok=True)
        for file in messages:
            write_whole(package / "msg" / file.name, file.read_text(encoding="utf-8"))
        names = sorted(file.name for file in messages)
        write_whole(package / "package.xml", _package_xml())
        write_whole(package / "CMakeLists.txt", _cmake(names))
    except OSError as error:
        raise InputError(f"{package}: cannot be written: {error.strerror}") from error
    typer.echo(package)


def _package_xml() -> str:
    return _PACKAGE_XML.format(
        package=PACKAGE, version=version("funnel-hil"), license="Apache-2.0",
        depends="\n".join(f"  <depend>{name}</depend>" for name in _DEPENDENCIES),
    )  # fmt: skip


def _cmake(names: list[str]) -> str:
    return _CMAKE.format(
        package=PACKAGE, dependencies=" ".join(_DEPENDENCIES),
        found="\n".join(f"find_package({name} REQUIRED)" for name in _DEPENDENCIES),
        messages="\n".join(f'  "msg/{name}"' for name in names),
    )  # fmt: skip
