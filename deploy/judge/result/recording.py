"""Recording of a run: how complete it is, and who commanded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.messages import topics
from deploy.judge.motion.torques import torques
from deploy.judge.recorded_ticks import KnownTicks, rows_after_gaps
from deploy.judge.result.section import Section
from deploy.judge.run_data import RunData

UNAUTHENTICATED = (
    "without link.security, the check of the commander protects against mistakes, but not against"
    " someone who copies the commander's id"
)
_MOST_GAPS = 20


class Recorder(Section):
    """Counts of the recorder.

    Attributes:
        messages: messages in the recording
        lost: messages that the recorder missed; null if it could not count
        lost_by_topic: the same by topic
        complete: whether the recorder finished the file
    """

    messages: int
    lost: int | None
    lost_by_topic: dict[str, int] | None
    complete: bool


class Recording(Section):
    """Completeness of a recording.

    Attributes:
        damage: what is damaged, one sentence each
        rejected: messages that another sender sent in the name of a process, by reason
        notes: other remarks, one sentence each
        ticks_known: ticks whose true motion is known
        ticks_skipped: ticks that a late plant skipped
        gaps_s: where ticks are missing, as pairs of times (the first 20)
        torque_left_out_s: time around gaps that the torque figures leave out
        settling_is_latest: whether the settling time is only an upper limit because of a gap, per
            joint
    """

    damage: list[str]
    rejected: dict[str, int]
    notes: list[str]
    ticks_known: int
    ticks_skipped: int
    gaps_s: list[tuple[float, float]]
    torque_left_out_s: float
    settling_is_latest: list[bool]


class Commander(Section):
    """Security of "one commander".

    Attributes:
        authenticated: whether the controller had to prove who it is; null unless over Zenoh
        note: explanation of that value
    """

    authenticated: bool | None
    note: str | None


def recorder(run: RunData) -> Recorder:
    """Return the counts of the recorder."""
    return Recorder(
        messages=run.messages,
        lost=None if run.lost is None else sum(run.lost.values()),
        lost_by_topic=None if run.lost is None else dict(run.lost),
        complete=run.complete,
    )


def recording(
    run: RunData, known: KnownTicks, damage: list[str], settled_s: Sequence[float | None]
) -> Recording:
    """Return how complete a recording is.

    Args:
        run: the run.
        known: its known ticks.
        damage: what is damaged, one sentence each.
        settled_s: settling time of each joint.
    """
    skipped = run.tables[topics.PLANT_TRUTH.name]["timing.skipped"]
    torque_times_s, _, after_gaps = torques(run)
    steps_s = np.abs(np.diff(torque_times_s, prepend=torque_times_s[:1]))
    times_s = run.times_s(topics.PLANT_TRUTH)
    behind_gaps_s = set(times_s[rows_after_gaps(run, times_s)].tolist())
    return Recording(
        damage=damage,
        rejected=dict(run.rejected),
        notes=run.notes,
        ticks_known=known.known,
        ticks_skipped=int(skipped.max(initial=0)),
        gaps_s=known.gaps_s[:_MOST_GAPS],
        torque_left_out_s=float(steps_s[after_gaps].sum()),
        settling_is_latest=[time_s in behind_gaps_s for time_s in settled_s],
    )


def commander(run: RunData) -> Commander:
    """Return whether senders had to prove their identity."""
    if run.link != "zenoh":
        return Commander(authenticated=None, note=None)
    is_authenticated = run.setup.scenario.link.security.enabled
    return Commander(
        authenticated=is_authenticated, note=None if is_authenticated else UNAUTHENTICATED
    )
