"""Margin expected by theory, and the first values that the search for it tries."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from deploy.study.margin_search import Steps
from deploy.study.settings import Setting
from deploy.study.theory.theory import theory_of


def theory_beside(setting: Setting) -> dict[str, Any]:
    """Return what theory says about a setting's delay; or why it says nothing.

    Returns:
        The result of `theory_of`, with ``beside_ms``: the delay of the direction that is not
        varied, which is part of each round trip.
    """
    link, keys = setting.base.link, setting.quantity.keys
    if not (link.uplink.is_constant and link.downlink.is_constant):
        return {"reason": "the scenario's own delays vary, or messages are lost"}
    if link.playout_ns:
        return {"reason": "the play-out holds commands back"}
    channels = {"link.uplink.delay_ms": link.uplink, "link.downlink.delay_ms": link.downlink}
    beside_ms = sum(channel.delay_ms for key, channel in channels.items() if key not in keys)
    return {**theory_of(setting.base), "beside_ms": beside_ms}


def first_loss(theory: Mapping[str, Any], steps: Steps) -> list[int]:
    """Return the last value below the first window of instability, and one in it, in steps.

    Args:
        theory: of `theory_beside`, with windows.
        steps: the values that can be probed.
    """
    if not theory["unstable_ms"]:
        return [steps.limit]
    (begin, end), beside = theory["unstable_ms"][0], theory["beside_ms"] + steps.origin
    below = math.floor((begin - beside) / steps.resolution)
    inside = below + 1
    if end is not None:  # growth is fastest far from both ends
        inside = max(inside, round((0.5 * (begin + end) - beside) / steps.resolution))
    return [each for each in (below, inside) if 0 < each <= steps.limit] or [steps.limit]
