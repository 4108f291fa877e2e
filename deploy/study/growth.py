"""Whether a study is an earlier one with more: seeds, points, laws or anything else it tries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bus_schema.configuration import shown
from controller.laws import LAWS

_LISTS = ("seeds", "laws", "scenarios", "compensation", "drive_feedback", "running", "offsets",
          "values")  # fmt: skip
"""What a study tries one after another: more of it leaves the runs that are there as they were."""


def hindrances(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Why a study cannot be made of another by adding to it, a sentence for each key; [] if it can.

    Args:
        found: what the other is, as ``study.yaml`` has it.
        wanted: the same of the study.
    """
    if found.get("kind") != wanted["kind"]:
        return [_differs("kind", found.get("kind"), wanted["kind"])]
    old, new = found.get("definition"), wanted["definition"]
    if not isinstance(old, dict):
        return ["definition: is missing"]
    said = [
        sentence
        for key in dict.fromkeys((*old, *new))
        for sentence in _of_key(key, old.get(key), new.get(key))
    ]
    digests = found.get("scenario_digests") or {}
    changed = [name for name, digest in digests.items() if not _is_kept(name, digest, wanted)]
    return said or [f"scenario {name}: has changed" for name in changed]


def _of_key(key: str, old: Any, new: Any) -> Iterator[str]:
    if key == "grid" and isinstance(old, dict) and isinstance(new, dict):
        for axis in dict.fromkeys((*old, *new)):
            if not _has_all(new.get(axis), old.get(axis)):
                yield _lacks(f"grid.{axis}", old.get(axis), new.get(axis))
    elif key == "plants" and isinstance(old, int) and isinstance(new, int):
        if new < old:
            yield _lacks(key, old, new)
    elif key == "laws" and new is None and isinstance(old, list):  # of all laws
        if not set(old) <= set(LAWS):
            yield _lacks(key, old, new)
    elif key in _LISTS and isinstance(old, list) and isinstance(new, list):
        if not _has_all(new, old):
            yield _lacks(key, old, new)
    elif old != new:
        yield _differs(key, old, new)


def _has_all(new: Any, old: Any) -> bool:
    return isinstance(new, list) and isinstance(old, list) and all(each in new for each in old)


def _is_kept(name: str, digest: Any, wanted: Mapping[str, Any]) -> bool:
    return bool(wanted["scenario_digests"].get(name, digest) == digest)


def _lacks(key: str, old: Any, new: Any) -> str:
    if old is None:
        return f"{key} = {shown(new)}: must be left out"
    return f"{key} = {shown(new)}: must have all of {shown(old)}"


def _differs(key: str, old: Any, new: Any) -> str:
    return f"{key} = {shown(new)}: must be {shown(old)}"
