"""The test behind a result, which a gate compares with the test behind its baseline.

The test is everything that decides how hard a law has it: arm, reference, funnel, duration, starts,
seeds, rate, engine, plant, link, errors of the nominal model and the time that the law takes. The
subject of the test is left out: the law, its gains, compensation and a drive loop.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any

from bus_schema.configuration import shown
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.effective import values_in_common
from deploy.scenario.link_kinds.kind import LINK_KINDS
from deploy.scenario.referenced_files import DATA_FILES
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError

Tested = Mapping[str, Mapping[str, Any]]
"""Values of a test by dotted key: of each scenario by its name, and of `STUDY`."""

TESTED_WITH = "tested_with"
"""Key of the test in ``summary.json``."""
STUDY = "study"
_OF_THE_LAW = ("controller.", "plant.drive_feedback.stiffness_nm_rad",
               "plant.drive_feedback.damping_nm_s")  # fmt: skip
_GIVEN_TO_THE_LAW = ("model", "model_scale", "rotor_scale", "every", "inference_ms",
                     "inference_jitter_ms", "first_inference_ms")  # fmt: skip
_WITHOUT_EFFECT = ("name", "clock", "seed", "robot.drive_data", "link.domain", "link.security.",
                   "link.publish_")  # fmt: skip
"""Keys that change no number of a gate; ``seed`` is one of a study's seeds."""
_FILES = ("robot.urdf", *DATA_FILES)
_DIGITS = 16
_MOST_SHOWN = 10


def tested_with(setups: Iterable[Setup], study: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the test of results.

    Args:
        setups: scenarios of the results.
        study: values that a study adds, such as seeds.
    """
    return {**{setup.scenario.name: _test_of(setup) for setup in setups}, STUDY: dict(study)}


def _test_of(setup: Setup) -> dict[str, Any]:
    """Return the values in force that belong to the test; files as digests."""
    given = tuple(f"controller.{name}" for name in _GIVEN_TO_THE_LAW)
    others = tuple(f"link.{kind}." for kind in LINK_KINDS if kind != setup.scenario.link.kind)
    left_out = (*_WITHOUT_EFFECT, *others)
    return {
        key: _digest(text) if key in _FILES else json.loads(text)
        for key, text in values_in_common(setup).items()
        if key in given or not key.startswith((*left_out, *_OF_THE_LAW))
    }


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def require_same_test(before: Tested | None, now: Tested, *, allows_changes: bool) -> list[str]:
    """Return how the test of a baseline differs, a sentence for each value; [] if it does not.

    Args:
        before: the test of the baseline; None if it has none.
        now: the test of the results that are compared with it.
        allows_changes: whether tests may differ.

    Raises:
        ScenarioError: they differ, but must not.
    """
    if before is None:
        found = ["does not say how it was tested, as an older version of funnel-hil made it"]
    else:
        found = [
            each
            for place in now
            if place in before
            for each in _changes(place, before[place], now[place])
        ]
    if found and not allows_changes:
        shown_ones = "; ".join(found[:_MOST_SHOWN])
        more = f"; and {len(found) - _MOST_SHOWN} more" if len(found) > _MOST_SHOWN else ""
        raise ScenarioError(
            f"--baseline: {shown_ones}{more}: must have the same test; make the baseline again, or"
            " accept the difference with --allow-changes"
        )
    return found


@cache
def _defaults() -> dict[str, Any]:
    return ScenarioConfiguration.model_construct().model_dump(mode="json", warnings=False)


def _default(key: str) -> Any:
    """Return a scenario's default, which holds where a version does not know the key; else None."""
    found: Any = _defaults()
    for part in key.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    return found


def _changes(place: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    prefix = "" if place == STUDY else f"{place}: "
    for key in dict.fromkeys((*before, *now)):
        old, new = (side.get(key, _default(key)) for side in (before, now))
        if json.dumps(old) == json.dumps(new):
            continue
        if key in _FILES and old and new:  # digests tell a reader nothing
            yield f"{prefix}{key}: the file or its arguments changed"
        else:
            yield f"{prefix}{key} = {shown(old)} before, {shown(new)} now"
