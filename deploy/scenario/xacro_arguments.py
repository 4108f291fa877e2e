"""Arguments of xacro as words of a command: ``ur.urdf.xacro name:=ur ur_type:=ur10e``."""

from __future__ import annotations

import re


def split_arguments(words: str) -> tuple[str, dict[str, str]]:
    """Return an arm's file and the arguments that follow it, as in ``ur.xacro ur_type:=ur5e``."""
    file, *given = re.split(r"\s+(?=[A-Za-z_]\w*:=)", words)
    return file, {name: value for name, _, value in (each.partition(":=") for each in given)}


def join_arguments(words: list[str]) -> list[str]:
    """Return the words of a command with the arguments of a xacro file joined to it."""
    joined: list[str] = []
    for word in words:
        is_argument = re.match(r"[A-Za-z_]\w*:=", word)
        at = next((i for i in reversed(range(len(joined))) if ".xacro" in joined[i]), None)
        if is_argument and at is not None:
            joined[at] += f" {word}"
        else:
            joined.append(word)
    return joined
