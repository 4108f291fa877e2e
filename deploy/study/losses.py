"""Plants that kept their bounds, and common properties of those that did not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from deploy.judge.findings.link_delays import share_interval
from deploy.study.plants import Measured

_LEAST_EACH = 3
"""Number of lost, and of kept, plants below which nothing is reported about common properties."""
_SHUFFLES = 1000
_SHUFFLE_SEED = 1


def share_kept(kept: int, total: int) -> dict[str, Any]:
    """Return a share with its interval, ready for JSON."""
    return {
        "kept": kept,
        "total": total,
        "fraction": kept / total if total else None,
        "wilson_95": list(share_interval(kept, total)) if total else None,
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
        lost: which plants were lost, shape (values, plants); NaN where one was not tried.

    Returns:
        ``lost_plants`` and ``kept_plants``, at one value or more; ``chance_level``, and ``effects``
        with ``quantity`` and ``effect``, null if no value has both lost and kept plants, or too
        few.
    """
    was_lost, was_kept = lost == 1, lost == 0
    is_mixed = was_lost.any(axis=1) & was_kept.any(axis=1)
    counts = {
        "lost_plants": int(was_lost.any(axis=0).sum()),
        "kept_plants": int(was_kept.any(axis=0).sum()),
    }
    mixed = was_lost[is_mixed], was_kept[is_mixed]
    if min(int(which.any(axis=0).sum()) for which in mixed) < _LEAST_EACH or not quantities:
        return {**counts, "chance_level": None, "effects": None}
    effects, chance_level = _effects(quantities, *mixed)
    found = sorted(zip(quantities, effects, strict=True), key=lambda pair: -abs(pair[1]))
    named = [{"quantity": quantity.name, "effect": effect} for quantity, effect in found]
    return {**counts, "chance_level": chance_level, "effects": named}


def _effects(
    quantities: Sequence[Measured], lost: np.ndarray[Any, Any], kept: np.ndarray[Any, Any]
) -> tuple[list[float], float]:
    """Return each quantity's effect, and the chance level, from values with lost and kept."""
    values = np.array([quantity.values for quantity in quantities])
    # By pair of plants: which has more, and at how many values the one was lost, the other kept.
    more = np.sign(values[:, :, None] - values[:, None, :]).reshape(len(values), -1)
    times = lost.astype(np.float64).T @ kept

    def effects(order: np.ndarray[Any, Any]) -> Vector:
        return np.asarray(more @ times[np.ix_(order, order)].ravel() / times.sum())

    random, plants = np.random.default_rng(_SHUFFLE_SEED), np.arange(len(times))
    strongest = [np.abs(effects(random.permutation(plants))).max() for _ in range(_SHUFFLES)]
    return effects(plants).tolist(), float(np.quantile(strongest, 0.95))
