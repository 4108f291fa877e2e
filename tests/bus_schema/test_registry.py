"""Tables of names: when entries are imported, and the message about an unknown name."""

from __future__ import annotations

from collections import Counter

import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.registry import REGISTRIES, Registry


@pytest.fixture(autouse=True)
def no_more_registries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus_schema.registry.REGISTRIES", dict(REGISTRIES))


def shapes(**shipped: object) -> Registry[object]:
    return Registry("shapes", "shape.kind", object, shipped)


def test_entry_is_imported_when_it_is_used_and_not_before() -> None:
    registry = shapes(tally="collections:Counter", missing="no_such_module:Anything", number=3)
    assert registry["tally"] is Counter
    assert registry["number"] == 3
    with pytest.raises(ModuleNotFoundError):
        _ = registry["missing"]


def test_unknown_name_is_refused_with_key_value_and_all_names() -> None:
    registry = shapes(a="x:A", b="x:B")
    registry.shipped["c"] = "x:C"
    for refuse in (registry.check, registry.__getitem__):
        with pytest.raises(ConfigurationError) as refusal:
            refuse("round")
        assert str(refusal.value) == "shape.kind = 'round': must be 'a', 'b' or 'c'"


def test_registry_without_entries_says_so() -> None:
    with pytest.raises(ConfigurationError, match="must be left out: no installed package adds one"):
        shapes().check("round")
