"""Where URDF files come from."""

from __future__ import annotations

import importlib.util
from importlib import resources
from pathlib import Path

from bus_schema.errors import RobotDescriptionError

ROBOTS = Path(str(resources.files("deploy").joinpath("robots")))
_PYBULLET_DATA = "pybullet_data:"


def find_urdf(name: str, base: Path) -> Path:
    """The URDF file that a scenario names.

    Args:
        name: a path relative to `base`, the name of a shipped robot, or ``pybullet_data:`` with a
            path inside that package.
        base: folder of the scenario.

    Raises:
        RobotDescriptionError: there is no such file.
    """
    if name.startswith(_PYBULLET_DATA):
        spec = importlib.util.find_spec("pybullet_data")
        folders = list(spec.submodule_search_locations or []) if spec is not None else []
        candidates = [Path(folder) / name.removeprefix(_PYBULLET_DATA) for folder in folders]
    else:
        candidates = [base / name, ROBOTS / f"{name}.urdf"]
    for candidate in candidates:
        if candidate.is_file():
            return candidate.resolve()
    shipped = ", ".join(sorted(path.stem for path in ROBOTS.glob("*.urdf")))
    raise RobotDescriptionError(
        f"no such file; allowed are a path from {base}, a shipped robot ({shipped}), or"
        f" {_PYBULLET_DATA}<path in the package pybullet_data>"
    )
