"""Log of how chunks followed each other: jumps, ages of observations, and states without a row."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from controller.chunks.answer import Answer

_MOST = 1000
_MS = 1e3


class ChunkLog:
    """Log of the answers of a law.

    Args:
        has_targets: whether answers contain targets, which can jump.
    """

    def __init__(self, *, has_targets: bool) -> None:
        self._has_targets = has_targets
        self._stretches_s: list[list[float]] = []
        self._switches: list[list[float]] = []
        self._targets_rad: list[tuple[list[float], list[float]]] = []
        self._largest: dict[str, Any] | None = None
        self._ages_ms: Counter[float] = Counter()
        self._starved = self._ticks = self._count = 0
        self._is_starved = False

    def note(self, acting: Answer, now_s: float) -> None:
        """Note the answer in force at a state."""
        is_starved = acting.is_over_at(now_s)
        if is_starved:
            self._starved += 1
            if not self._is_starved:
                self._stretches_s.append([now_s, now_s])
            self._stretches_s[-1][1] = now_s
        self._is_starved = is_starved
        self._ticks += 1
        self._ages_ms[round(_MS * (now_s - acting.asked_s), 3)] += 1

    def note_switch(self, old: Answer, new: Answer, now_s: float) -> None:
        """Note that an answer took over from another one."""
        self._count += 1
        before, after = old.target_at(now_s)[0], new.target_at(now_s)[0]
        sizes: Vector = np.abs(after - before) if self._has_targets else np.zeros(1)
        joint = int(sizes.argmax())
        size = float(sizes[joint])
        if len(self._switches) < _MOST:
            self._switches.append([now_s, new.asked_s, size, joint])
            if self._has_targets:
                self._targets_rad.append((before.tolist(), after.tolist()))
        if self._has_targets and (self._largest is None or size > self._largest["jump_rad"]):
            self._largest = {
                "jump_rad": size, "time_s": now_s, "joint": joint,
                "before_rad": before.tolist(), "after_rad": after.tolist(),
            }  # fmt: skip

    def starved(self) -> dict[str, Any]:
        """Return the states without a row, and the first stretches of them, ready for JSON."""
        return {"ticks": self._starved, "stretches_s": self._stretches_s[:_MOST]}

    def summary(self) -> dict[str, Any]:
        """Return counts, ages and the first switches, ready for JSON.

        A switch is its time, the time of its question, the largest jump of a target, rad, and the
        number of that joint. Its targets are those before and after it, rad.
        """
        return {
            "states": self._ticks,
            "switches": self._count,
            "first_switches": self._switches,
            "first_targets_rad": self._targets_rad,
            "largest": self._largest,
            "age_ms": self._ages(),
        }

    def _ages(self) -> dict[str, float]:
        """Return median and largest age of the observation behind the action in force, ms."""
        ages = sorted(self._ages_ms)
        passed, half = 0, (self._ticks + 1) // 2
        for age in ages:
            passed += self._ages_ms[age]
            if passed >= half:
                return {"median": age, "largest": ages[-1]}
        return {"median": 0.0, "largest": 0.0}
