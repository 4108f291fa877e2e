"""Plants that kept their bounds, and common properties of those that did not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from deploy.study.plants import Measured

_Z_95 = 1.959963984540054
_LEAST_EACH = 3
"""Number of lost, and of kept, plants below which nothing is reported about common properties."""
_SHUFFLES = 1000
_SHUFFLE_SEED = 1


def wilson(kept: int, total: int) -> tuple[float, float] | None:
    """Return Wilson's 95 % interval of a share; None for no plants."""
    if total == 0:
        return None
    share, spread = kept / total, _Z_95 * _Z_95 / total
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = math.sqrt(share * (1.0 - share) * spread + 0.25 * spread * spread) / (1.0 + spread)
    # At the ends of the range they are exact, except for rounding.
    low = 0.0 if kept == 0 else max(0.0, middle - half)
    return low, 1.0 if kept == total else min(1.0, middle + half)


def share_kept(kept: int, total: int) -> dict[str, Any]:
    """Return a share with its interval, ready for JSON."""
    interval = wilson(kept, total)
    return {
        "kept": kept,
        "total": total,
        "fraction": kept / total if total else None,
        "wilson_95": None if interval is None else list(interval),
    }


def rank_losses(quantities: Sequence[Measured], lost: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Return the common properties of lost plants, the strongest first, ready for JSON.

    The effect is the rank-biserial correlation of Mann and Whitney's U, 2 AUC − 1: 1 if every lost
    plant had more of a quantity than every kept one, −1 if less, 0 if it makes no difference. Pairs
    are formed within each tried value, and counted over all values. The strongest of many effects
    is large by chance, especially with few losses: in 5 % of shuffles of whole plants, the
    strongest effect exceeds the chance level.

    Args:
        quantities: the drawn numbers.
        lost: which plants were lost, shape (values, plants).

    Returns:
        ``lost_plants`` and ``kept_plants``, at one value or more; ``chance_level``, and ``effects``
        with ``quantity`` and ``effect``, null if no value has both lost and kept plants, or too
        few.
    """
    mixed = lost[lost.any(axis=1) & ~lost.all(axis=1)]
    counts = {
        "lost_plants": int(lost.any(axis=0).sum()),
        "kept_plants": int((~lost).any(axis=0).sum()),
    }
    least = min(int(which.any(axis=0).sum()) for which in (mixed, ~mixed))
    if least < _LEAST_EACH or not quantities:
        return {**counts, "chance_level": None, "effects": None}
    effects, chance_level = _effects(quantities, mixed)
    found = sorted(zip(quantities, effects, strict=True), key=lambda pair: -abs(pair[1]))
    named = [{"quantity": quantity.name, "effect": effect} for quantity, effect in found]
    return {**counts, "chance_level": chance_level, "effects": named}


def _effects(
    quantities: Sequence[Measured], mixed: np.ndarray[Any, Any]
) -> tuple[list[float], float]:
    """Return each quantity's effect, and the chance level; `mixed`: values with lost and kept."""
    ranks = np.array([_midranks(quantity.values) for quantity in quantities])
    times_lost = mixed.sum(axis=0).astype(np.float64)
    each = mixed.sum(axis=1)
    pairs = float((each * (mixed.shape[1] - each)).sum())
    least_rank_sum = float((each * (each + 1) / 2).sum())

    def effects(losses: Vector) -> Vector:
        # Exact for any order of BLAS's sums: ranks are halves, and losses whole numbers.
        return 2.0 * (ranks @ losses - least_rank_sum) / pairs - 1.0

    random = np.random.default_rng(_SHUFFLE_SEED)
    strongest = [np.abs(effects(random.permutation(times_lost))).max() for _ in range(_SHUFFLES)]
    return effects(times_lost).tolist(), float(np.quantile(strongest, 0.95))


def _midranks(values: Vector) -> Vector:
    """Return ranks from 1 on; equal values share the mean of theirs."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - 0.5 * (counts - 1.0))[which], dtype=np.float64)
