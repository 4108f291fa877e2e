"""Growth of studies: whether one extends an earlier one by seeds, points, laws or other values."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from bus_schema.configuration import shown
from controller.laws import COMPARED_LAWS
from deploy.study.study import column_type

_TYPES = {
    "bool": "true or false",
    "double": "numbers",
    "string": "neither numbers nor true or false",
}
"""Kind of a grid's values, by the Parquet type of their column."""
_ADDS_FINDINGS = ("what_helps", "smaller_rotors")
"""Keys that only ask for more runs, or for fewer."""
_ADDS_RUNS = (("pattern", None), ("disturbances", None))
"""Keys and earlier values with which all earlier runs are still those of the study."""


def hindrances(
    found: Mapping[str, Any], wanted: Mapping[str, Any], digests: Collection[tuple[str, str]]
) -> list[str]:
    """Explain, a sentence per key, why a study does not extend another; [] if it does.

    Args:
        found: the other study, in the form of ``study.yaml``.
        wanted: the study, in the same form.
        digests: name and digest of each scenario of the study, in every setting.
    """
    if found.get("kind") != wanted["kind"]:
        return list(_of_key("kind", found.get("kind"), wanted["kind"]))
    old, new = found.get("definition"), wanted["definition"]
    if not isinstance(old, dict):
        return ["definition: is missing"]
    if "exhaustive" in new:  # as studies of older versions were
        old = {"exhaustive": True, **old}
    sentences = [
        sentence
        for key in dict.fromkeys((*old, *new))
        for sentence in _of_key(key, old.get(key), new.get(key))
    ]
    return sentences or changes(found, wanted, digests)


def changes(
    found: Mapping[str, Any], wanted: Mapping[str, Any], digests: Collection[tuple[str, str]]
) -> list[str]:
    """Return which scenarios and files have changed, a sentence each; as for `hindrances`."""
    known = {"scenario": digests, "file": wanted.get("file_digests", {}).items()}
    return [
        f"{what} {before[0]}: has changed"
        for what, now in known.items()
        for before in (found.get(f"{what}_digests") or {}).items()
        if before not in now
    ]


def _of_key(key: str, old: Any, new: Any) -> Iterator[str]:
    if key == "grid" and isinstance(old, dict) and isinstance(new, dict):
        for axis in dict.fromkeys((*old, *new)):
            before, now = old.get(axis), new.get(axis)
            if not _has_all(now, before):
                yield _lacks(f"grid.{axis}", before, now)
            elif (kind := column_type(old[axis])) != column_type(new[axis]):
                yield f"grid.{axis} = {shown(now)}: must all be {_TYPES[kind]}, as before"
    elif key == "gains" and isinstance(old, dict) and isinstance(new, dict):
        yield from _of_gains(old, new)
    elif key in ("plants", "budget") and isinstance(old, int) and isinstance(new, int):
        if new < old:
            yield _lacks(key, old, new)
    elif isinstance(old, list) and (isinstance(new, list) or key == "laws"):  # tried in turn
        if not _has_all(COMPARED_LAWS if new is None else new, old):
            yield _lacks(key, old, new)
    elif old != new and key not in _ADDS_FINDINGS and (key, old) not in _ADDS_RUNS:
        yield f"{key} = {shown(new)}: must be {shown(old)}"


def _of_gains(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """Explain which gains of a law on an arm have changed; further ones are welcome."""
    for arm, laws in old.items():
        for law, before in laws.items():
            now = new.get(arm, {}).get(law)
            if now != before:
                yield f"gains of {law} on {arm} = {shown(now)}: must be {shown(before)}, as before"


def _has_all(new: Any, old: Any) -> bool:
    return isinstance(new, list) and isinstance(old, list) and all(each in new for each in old)


def _lacks(key: str, old: Any, new: Any) -> str:
    allowed = "be left out" if old is None else f"have all of {shown(old)}"
    return f"{key} = {shown(new)}: must {allowed}"
