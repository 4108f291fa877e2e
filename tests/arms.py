"""Arms that tests are done with."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schema.urdf.resolved import pybullet_data

ARMS = ("paper_arm", "iiwa", "panda")
PYBULLET_DATA = next(iter(pybullet_data()), Path("pybullet_data"))
"""Folder of more arms, where that package is installed."""
needs_pybullet_data = pytest.mark.skipif(
    not pybullet_data(), reason="pybullet_data is not installed: pip install 'funnel-hil[bullet]'"
)


def listed_from_the_tip(urdf: Path, folder: Path) -> Path:
    """A file in a folder with the same arm, its joints in the opposite order."""
    blocks = urdf.read_text().split("<joint ")
    head, links = blocks[0], [block.partition("</joint>") for block in blocks[1:]]
    joints = [f"<joint {inner}</joint>" for inner, _, _ in links][::-1]
    rest = "".join(tail for _, _, tail in links).replace("</robot>", "")
    path = folder / "reversed.urdf"
    path.write_text(f"{head}{rest}{''.join(joints)}</robot>")
    return path
