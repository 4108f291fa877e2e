"""Unknowns of an arm that may make its margin smaller: rotors, and the model's error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from deploy.scenario.checking.warnings import ROTORS, tenth_of_rotors
from deploy.scenario.yaml_files import override
from deploy.study.follow_ups.trials import Changes
from deploy.study.margin_search import MarginSearch
from deploy.study.settings import Setting

SMALLER_ROTORS, MODEL_ERRORS = "smaller_rotors", "model_errors"
"""Keys of a study that ask for them, and of what was found."""
_MODEL_SCALE = "controller.model_scale"


def changes(setting: Setting, *, smaller_rotors: bool, model_errors: Iterable[float]) -> Changes:
    """Return the overrides of each unknown, by name.

    Args:
        setting: the setting; what it gives by itself is known.
        smaller_rotors: whether to try a tenth of estimated rotors.
        model_errors: factors on its ``controller.model_scale``.
    """
    given = {text.partition("=")[0] for text in setting.overrides} | {*setting.quantity.keys}
    found: dict[str, tuple[str, ...]] = {}
    if smaller_rotors and ROTORS not in given:
        tenth = tenth_of_rotors(setting.base)
        found |= {} if tenth is None else {"rotors × 0.1": (tenth,)}
    if _MODEL_SCALE not in given:
        own = setting.base.scenario.controller.model_scale
        for factor in model_errors:
            found[f"model masses × {factor:g}"] = (override(_MODEL_SCALE, round(factor * own, 9)),)
    return found


def findings(searches: Mapping[str, MarginSearch], tried: Changes) -> dict[str, Any]:
    """Return the margin with each unknown, up to the margin without it.

    Args:
        searches: the search of each unknown, by name.
        tried: the overrides of each, by name.
    """
    found = [
        {"change": name, "override": tried[name][0], **search.ends()}
        for name, search in searches.items()
        if name in tried
    ]
    rotors = [each for each in found if each["override"].startswith(ROTORS)]
    models = [each for each in found if each not in rotors]
    return {SMALLER_ROTORS: rotors[0] if rotors else None, MODEL_ERRORS: models}
