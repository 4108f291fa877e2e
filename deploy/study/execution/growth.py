"""Growth of studies: whether one extends an earlier one by seeds, points, laws or other values."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any

from bus_schema.configuration import shown
from controller.laws import COMPARED_LAWS

Growth = Callable[[str, Any, Any], Iterable[str]]
"""Explains, from a key of a definition and its value in both, why a study does not extend another:
a sentence each."""


def hindrances(
    found: Mapping[str, Any],
    wanted: Mapping[str, Any],
    digests: Collection[tuple[str, str]],
    growth: Mapping[str, Growth],
) -> list[str]:
    """Explain, a sentence per key, why a study does not extend another; [] if it does.

    Args:
        found: the other study, in the form of ``study.yaml``.
        wanted: the study, in the same form.
        digests: name and digest of each scenario of the study, in every setting.
        growth: how keys of this kind of study may change, if not as usual.
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
        for sentence in growth.get(key, _of_key)(key, old.get(key), new.get(key))
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
    """Lists grow by further entries; anything else stays."""
    if isinstance(old, list) and (isinstance(new, list) or key == "laws"):  # tried in turn
        if not has_all(COMPARED_LAWS if new is None else new, old):
            yield lacks(key, old, new)
    elif old != new:
        yield f"{key} = {shown(new)}: must be {shown(old)}"


def may_rise(key: str, old: Any, new: Any) -> Iterator[str]:
    """A number may become larger."""
    if not (isinstance(old, int) and isinstance(new, int)):
        yield from _of_key(key, old, new)
    elif new < old:
        yield lacks(key, old, new)


def may_change(_key: str, _old: Any, _new: Any) -> Iterator[str]:
    """The key only asks for more runs, or for fewer."""
    return iter(())


def may_be_added(key: str, old: Any, new: Any) -> Iterator[str]:
    """All earlier runs are still those of the study, if the key was left out."""
    return iter(()) if old is None else _of_key(key, old, new)


def has_all(new: Any, old: Any) -> bool:
    """Whether a list has all entries of another."""
    return isinstance(new, list) and isinstance(old, list) and all(each in new for each in old)


def lacks(key: str, old: Any, new: Any) -> str:
    """Explain that a key lacks earlier values."""
    allowed = "be left out" if old is None else f"have all of {shown(old)}"
    return f"{key} = {shown(new)}: must {allowed}"
