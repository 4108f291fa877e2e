"""Runs on which laws are tuned, and those on which they are judged: never the same."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from bus_schema.configuration import Positive, Whole
from deploy.scenario import study_keys
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, override
from deploy.study.definition import Different
from deploy.study.plants import UncertainDefinition, draw_plants

REAL_ARM = (
    f"plant.encoder.resolution_rad={2.0 * math.pi / 2**20}",
    "plant.encoder.velocity_noise_rad_s=6e-4",
)
"""Encoders of 20 bits. Rounding to q = 2π/2²⁰ rad is a white noise of q/√12; an observer of
bandwidth ω = 2π 100 rad/s makes of it a velocity noise of about q/√12 √(ω³ T/2) = 6e-4 rad/s at
T = 1 ms. On a perfect arm, laws gain precision from ever higher gains; a real one ends that."""
_ONE_PERIOD_MS = 1.0
_OTHER_START = -0.5
_OTHER_MOTION = {"amplitude_rad": 0.1, "frequency_rad_s": 2.0}


class TuneDefinition(UncertainDefinition):
    """Settings of a search for gains.

    Attributes:
        scenario: a scenario file, or the name of a shipped one.
        laws: the laws to tune.
        goal: ``rms`` for a small error with a smooth torque, ``margin`` for a large delay.
        budget: number of candidates for each law.
        search_seed: seed of the search.
        duration_s: longest duration of a run of the search.
        delays_ms: round trips that every candidate is tried at, for ``margin``.
        travel_limit_per_s: for ``rms``, how far a torque may travel, in its own limits per second:
            with it, the error alone counts below.
        ranges: least and largest value of gains, by name.
    """

    scenario: str
    laws: Different[str]
    goal: Literal["rms", "margin"] = "rms"
    budget: Annotated[Whole, Field(ge=2, le=10_000)] = 100
    search_seed: Annotated[Whole, Field(ge=1)] = 1
    duration_s: Positive = 8.0
    delays_ms: Different[Positive] = Field(default=[4.0, 8.0, 16.0, 32.0, 64.0, 128.0])
    travel_limit_per_s: Positive | None = None
    ranges: dict[str, tuple[Positive, Positive]] = Field(default_factory=dict)


class Place(NamedTuple):
    """Conditions of a run, of the search or of the verdict after it."""

    name: str
    overrides: tuple[str, ...]
    columns: Mapping[str, Any]


def searched(wanted: TuneDefinition) -> list[Place]:
    """Return the conditions in which every candidate is tried."""
    return list(_on_real_arm(wanted, Place("as tuned", (), {})))


def judged(wanted: TuneDefinition, base: Setup) -> list[Place]:
    """Return conditions that the search has not seen: seed, start, reference and plants.

    Args:
        wanted: the definition.
        base: its scenario, under any of the laws.
    """
    places = [Place("another seed", (), {}), *_another_start(base), *_another_reference(base)]
    if wanted.plants is not None:
        drawn = draw_plants(wanted, base, [study_keys.LAW, study_keys.SEED])
        places += [Place("other plants", each.overrides, each.columns) for each in drawn]
    return [one for place in places for one in _on_real_arm(wanted, place)]


def _on_real_arm(wanted: TuneDefinition, place: Place) -> Iterator[Place]:
    """Yield the place at one control period of delay, or at all delays."""
    for delay_ms in (_ONE_PERIOD_MS,) if wanted.goal == "rms" else wanted.delays_ms:
        delays = [override(key, 0.5 * delay_ms) for key in study_keys.DELAYS]
        yield Place(
            place.name, (*place.overrides, *delays),
            {**place.columns, "round_trip_ms": delay_ms},
        )  # fmt: skip


def _another_start(base: Setup) -> Iterator[Place]:
    """Yield the start on the other side of the reference, if the arm does not start on it."""
    offset_rad = base.scenario.robot.initial_offset_rad
    if offset_rad.any():
        start = override("robot.initial_offset_rad", (_OTHER_START * offset_rad).tolist())
        yield Place("another start", (start,), {"offset_scale": _OTHER_START})


def _another_reference(base: Setup) -> Iterator[Place]:
    """Yield small sinusoids around where the reference begins, where the arm's limits allow."""
    motion = np.empty((3, base.robot.joints))
    base.reference.evaluate(0.0, *motion)
    sinusoids = {
        "kind": "joint_sinusoids", "centre_rad": motion[0].tolist(), "terms": [_OTHER_MOTION],
    }  # fmt: skip
    place = Place("another reference", (override("reference", sinusoids),), {})
    try:
        load_setup(str(base.source), [*base.overrides, *place.overrides])
    except ScenarioError:
        return
    yield place
