"""MuJoCo, imported in one place: it reads MJCF files, and is one of the physics engines.

Importing it takes a tenth of a second, so import this module where it is used, not at the top.
"""

from __future__ import annotations

from bus_schema.safe_path import safe_path

with safe_path():  # its glfw starts a Python of its own
    import mujoco

__all__ = ["mujoco"]

# By default it appends its warnings to a file in the current folder.
mujoco.set_mju_user_warning(lambda _: None)
