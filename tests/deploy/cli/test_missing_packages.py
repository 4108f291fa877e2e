"""Extras: what is missing names the one that installs it, and ``all`` has those of wheels."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
NAMED = re.compile(
    r"needs_extra\([^)]*?['\"](\w+)['\"]\)|funnel-hil\[([\w,]+)\]"
    r"|extra=\"(?!forbid|allow|ignore)(\w+)\""
)
SOURCES = [
    file
    for room in ("bus_schema", "controller", "plant_emulator", "deploy")
    for file in (ROOT / room).rglob("*.py")
    if "docs" not in file.parts
]
NOT_IN_ALL = {"all", "bench", "bullet", "dev", "docs"}
"""Bullet has to be compiled on most hosts; the others are for a clone."""


def named_in(text):
    found = (name for groups in NAMED.findall(text) for name in groups)
    return {each for name in found for each in name.split(",") if each}


def test_extras_that_messages_name_exist_and_are_in_all():
    named = set().union(*(named_in(file.read_text(encoding="utf-8")) for file in SOURCES))
    assert {"papers", "live", "identify", "tuning", "policies", "frames", "bullet"} <= named
    assert named <= set(EXTRAS)
    assert named_in(" ".join(EXTRAS["all"])) == set(EXTRAS) - NOT_IN_ALL >= named - NOT_IN_ALL


@pytest.mark.parametrize("extra", sorted(set(EXTRAS) - {"all", "dev"}))
def test_no_message_tells_to_install_the_packages_of_an_extra_by_hand(extra):
    """Versions that work are those of the extra."""
    packages = [re.split(r"[\[>=;~!]", each)[0] for each in EXTRAS[extra]]
    by_hand = re.compile(rf"pip install ({'|'.join(map(re.escape, packages))})\b")
    assert not [file for file in SOURCES if by_hand.search(file.read_text(encoding="utf-8"))]
