"""Texts of small URDFs: links a, b and c, of which b and c weigh something."""

from __future__ import annotations

LIMIT = '<limit effort="5" velocity="3" lower="-1" upper="2"/>'


def inertial(mass: str = "2", ixx: str = "0.02", iyy: str = "0.03", izz: str = "0.04") -> str:
    return f"""<inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/>
      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>"""


def joint(name, parent, child, kind="revolute", axis="0 1 0", inside=LIMIT):
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
      <origin xyz="0.3 0 0"/><axis xyz="{axis}"/>{inside}</joint>"""


def two_links(first="", second="", b=None, c=None, a="", more=""):
    """By default two joints one after the other; with `more` elements at the end."""
    return f"""<robot name="test"><link name="a">{a}</link>
      <link name="b">{inertial() if b is None else b}</link>
      <link name="c">{inertial() if c is None else c}</link>
      {first or joint("first", "a", "b")}{second or joint("second", "b", "c")}{more}</robot>"""
