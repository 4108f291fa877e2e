"""Arms that tests are done with."""

from __future__ import annotations

from pathlib import Path

ARMS = (
    "paper_arm",
    "pybullet_data:kuka_iiwa/model.urdf",
    "pybullet_data:franka_panda/panda.urdf",
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
