"""MuJoCo, imported in one place: it reads MJCF files, and is one of the physics engines.

Importing it takes a tenth of a second, so import this module where it is used, not at the top.
"""

from __future__ import annotations

import mujoco

__all__ = ["mujoco"]

mujoco.set_mju_user_warning(lambda _: None)  # else it writes MUJOCO_LOG.TXT into the current folder
