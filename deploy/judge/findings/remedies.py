"""Changes, or laws to compare instead, after a loss for a reason."""

from __future__ import annotations

from collections.abc import Collection

from controller.laws import LAWS
from deploy.judge.findings.gravity import with_gravity
from deploy.judge.findings.loss_reason import Reason
from plant_emulator.interfaces.settings import TORQUE

FASTER = (
    "make the robot's own loop faster (with servoj, by a larger gain or a shorter lookahead_time_s)"
    ", or allow wider bounds (funnel)"
)


def remedy_of(reason: str, law: str, compared: Collection[str] = ()) -> str | None:
    """Return what helps a law that was lost for a reason, as part of a sentence; None if unknown.

    Args:
        reason: a `Reason`, as summaries and rows have it.
        law: the law's name.
        compared: laws beside it, which need not be named.
    """
    if reason == Reason.GRAVITY and (sibling := with_gravity(law)):
        if sibling in compared:
            return f"it has no gravity term, which {sibling} has"
        return f"compare {sibling}, which has a gravity term"
    if reason == Reason.JITTER:
        return "let targets wait until a fixed time after their states (link.playout_ms)"
    if reason != Reason.OWN_LAG:
        return None
    if law not in LAWS:
        return f"send each target earlier by that lag, {FASTER}"
    if LAWS[law].gives == TORQUE:
        ahead = "use a law of targets, such as position_correction or proportional_velocity, which"
        return f"{ahead} reads the reference ahead by that lag, {FASTER}"
    return f"read the reference ahead by it (controller.preview_ms: auto), {FASTER}"
