"""Section ``controller.chunks`` of a scenario: how a law's chunks follow each other."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from bus_schema.arrays import Vector
from bus_schema.configuration import ConfigurationError, Positive, StrictModel, Whole, validated
from bus_schema.registry import KnownNameIn, Registry
from controller.chunks.merge import ChunkMerge, ChunkTiming, MergeSettings
from controller.chunks.merges import (
    FrozenPrefixSettings,
    ReplaceSettings,
    SynchronousSettings,
    TemporalEnsembleSettings,
    WeightedSettings,
)
from controller.chunks.spline import SplineSettings

_KEY = "controller.chunks"
CHUNK_MERGES: Registry[type[MergeSettings]] = Registry(
    "chunk_merges",
    f"{_KEY}.merge",
    MergeSettings,
    {
        "replace": ReplaceSettings,
        "synchronous": SynchronousSettings,
        "weighted": WeightedSettings,
        "temporal_ensemble": TemporalEnsembleSettings,
        "frozen_prefix": FrozenPrefixSettings,
        "spline": SplineSettings,
    },
)
"""Rules by which a new chunk takes over from the one in force."""

_Actions = Annotated[Whole, Field(ge=1, le=10_000)]


class ChunksConfiguration(StrictModel):
    """Chunks of a law that answers with several actions, as many learned policies do.

    Attributes:
        horizon: actions of a chunk; by default as many as the law answers.
        period_ms: between two actions; by default the period of the control loop.
        ask_when: the law is asked when at most this share of the horizon is left; half of it by
            default.
        ask_every: instead of `ask_when`, it is asked after so many actions.
        merge: how a new chunk takes over: the name of a section.
        align: the first action of a chunk is meant for the ``time`` of its state; by ``count`` it
            acts when the chunk arrives.
        own: settings of a merge that an installed package adds.
    """

    horizon: _Actions | None = None
    period_ms: Annotated[Positive, Field(le=10_000)] | None = None
    ask_when: Annotated[Positive, Field(le=1)] | None = None
    ask_every: _Actions | None = None
    merge: Annotated[str, KnownNameIn("chunk_merges")] = "replace"
    align: Literal["time", "count"] = "time"
    own: dict[str, Any] = Field(default_factory=dict)
    replace: ReplaceSettings = ReplaceSettings()
    synchronous: SynchronousSettings = SynchronousSettings()
    weighted: WeightedSettings = WeightedSettings()
    temporal_ensemble: TemporalEnsembleSettings = TemporalEnsembleSettings()
    frozen_prefix: FrozenPrefixSettings = FrozenPrefixSettings()
    spline: SplineSettings = SplineSettings()

    @model_validator(mode="after")
    def _has_effect(self) -> ChunksConfiguration:
        if self.ask_every is not None and self.ask_when is not None:
            raise ValueError("ask_when must be left out with ask_every")
        if self.merge == "synchronous" and (self.ask_every or self.ask_when) is not None:
            raise ValueError("ask_when and ask_every must be left out with synchronous")
        for name in CHUNK_MERGES.shipped:
            if name != self.merge and getattr(self, name) != type(getattr(self, name))():
                raise ValueError(f"{name} must be left out with merge {self.merge}")
        if self.merge in CHUNK_MERGES.shipped and self.own:
            raise ValueError(f"own must be left out with merge {self.merge}")
        return self

    @property
    def settings(self) -> MergeSettings:
        """The section of its merge.

        Raises:
            ConfigurationError: `own` has wrong keys or values, or its package cannot be loaded.
        """
        if self.merge in CHUNK_MERGES.shipped:
            section: MergeSettings = getattr(self, self.merge)
            return section
        return validated(f"{_KEY}.own", CHUNK_MERGES[self.merge], self.own)

    @property
    def share_left(self) -> float:
        """Share of the horizon at or below which the law is asked."""
        return 0.5 if self.ask_when is None else self.ask_when

    def action_period_s(self, tick_s: float) -> float:
        """Return the time between two actions; the argument is the period of the control loop."""
        return tick_s if self.period_ms is None else 1e-3 * self.period_ms

    def executed_steps(self) -> int:
        """Return the actions from one question to the next, at least; 0 if the law chooses."""
        if self.ask_every is not None:
            return self.ask_every
        return 0 if self.horizon is None else self.horizon - int(self.share_left * self.horizon)

    @property
    def acts_on_arrival(self) -> bool:
        """Whether the next question waits for actions that begin when their chunk arrives."""
        by_count = self.align == "count" and self.ask_every is None
        return self.merge == "synchronous" or by_count

    def between_questions_s(self, tick_s: float) -> float | None:
        """Return the time of the actions between two questions; None if the law chooses it."""
        if self.horizon is None and self.ask_every is None:
            return None
        steps = self.horizon if self.merge == "synchronous" else self.executed_steps()
        return (steps or 0) * self.action_period_s(tick_s)

    def longest_inference_s(self, tick_s: float) -> float:
        """Return the longest inference time that the merge can work with; inf for any."""
        timing = self._timing(tick_s, 0.0, np.zeros(0))
        return self.settings.most_delay_steps(timing) * timing.period_s

    def build(self, tick_s: float, inference_s: float, velocities_rad_s: Vector) -> ChunkMerge:
        """Return a new merge.

        Args:
            tick_s: period of the control loop.
            inference_s: longest time from a question to its answer.
            velocities_rad_s: largest speeds of the joints, shape (joints,).

        Raises:
            ConfigurationError: the merge cannot work with these settings.
        """
        settings = self.settings
        if self.align == "count" and settings.needs_by_time:
            raise ConfigurationError(f"{_KEY}.align", "count", f"must be time with {self.merge}")
        timing = self._timing(tick_s, inference_s, velocities_rad_s)
        if problem := settings.problem(timing):
            raise ConfigurationError(f"{_KEY}.merge", self.merge, problem)
        return settings.build(timing)

    def _timing(self, tick_s: float, inference_s: float, velocities_rad_s: Vector) -> ChunkTiming:
        period_s = self.action_period_s(tick_s)
        delay_steps = math.ceil(inference_s / period_s - 1e-6)
        return ChunkTiming(
            period_s, tick_s, self.horizon or 0, delay_steps, self.executed_steps(),
            velocities_rad_s,
        )  # fmt: skip
