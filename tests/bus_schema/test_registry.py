"""Tables of names: when classes are imported, and the message about an unknown name."""

from __future__ import annotations

from collections import Counter

import pytest

from bus_schema.configuration import ConfigurationError, Registry


def test_class_is_imported_when_its_name_is_built_and_not_before() -> None:
    registry: Registry[object] = Registry(
        "shape.kind", {"tally": "collections:Counter", "missing": "no_such_module:Anything"}
    )
    assert registry.build("tally") == Counter()
    with pytest.raises(ModuleNotFoundError):
        registry.build("missing")


def test_unknown_name_is_refused_with_key_value_and_all_names() -> None:
    registry: Registry[object] = Registry("shape.kind", {"a": "x:A", "b": "x:B"})
    registry.places["c"] = "x:C"
    for refuse in (registry.check, registry.build):
        with pytest.raises(ConfigurationError) as refusal:
            refuse("round")
        assert str(refusal.value) == "shape.kind = 'round': must be 'a', 'b' or 'c'"
