"""Messages of a run: what the emulated link and the bus did to them."""

from __future__ import annotations

from typing import Annotated, Any

from bus_schema.arrays import PERCENTILES, percentiles
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.findings.link_delays import measured_link
from deploy.judge.result.section import Column, Section, Spread
from deploy.judge.run_data import RunData

_DELAYS = ("mean", *PERCENTILES)


class Channel(Section):
    """One direction: joint states up, commands down.

    Attributes:
        sent: messages that entered the emulated link
        delivered: those that the emulated link delivered, including copies
        lost: those that the emulated link lost
        duplicated: those that the emulated link delivered twice
        reordered: those that arrived after a later one
        resent: only over TCP — those that TCP sent again
        rejected: those that the receiver refused, by reason
        delay_ms: delay in the emulated link (mean, p50, p99, p99_9, max)
        loss_burst: messages lost in a row (mean, longest)
        measured_ms: one-way delay from the measurement to the controller, or from there to the
            joints, measured with one clock; includes the emulated link, the bus and any real delay;
            null in virtual time (p50, p99, p99_9, max)
    """

    only_sometimes = frozenset({"delay_ms", "loss_burst", "resent"})
    sent: Annotated[int | None, Column()]
    delivered: Annotated[int | None, Column()]
    lost: Annotated[int | None, Column()]
    duplicated: int | None
    reordered: int | None
    resent: int | None = None
    rejected: dict[str, int]
    delay_ms: Annotated[Spread | None, Column("delay_{}_ms", entries=_DELAYS)] = None
    loss_burst: Spread | None = None
    measured_ms: Spread


class Transport(Section):
    """Both directions of the link, and the bus.

    Attributes:
        can: only over CAN — load, worst latency, frames by identifier, errors
        playout: only with play-out — horizons and arrivals in ms, and answers that came too late
    """

    only_sometimes = frozenset({"can", "playout"})
    uplink: Annotated[Channel, Column("uplink_{}")]
    downlink: Annotated[Channel, Column("downlink_{}")]
    can: dict[str, Any] | None = None
    playout: dict[str, Any] | None = None


def transport(run: RunData) -> Transport:
    """Return what became of the messages of a run."""
    counts, measured = run.last_values(Role.PLANT, EventKind.COUNTS), measured_link(run)
    others = {name: counts[name] for name in ("can", "playout") if name in counts}
    return Transport(
        uplink=_channel(counts.get("uplink") or {}, measured["uplink"].delays_ms),
        downlink=_channel(counts.get("downlink") or {}, measured["downlink"].delays_ms),
        **others,
    )


def _channel(counts: dict[str, Any], delays_ms: Any) -> Channel:
    """Return a direction by the plant's counts; those of older versions lack some."""
    unknown = {
        "delay_ms": dict.fromkeys(_DELAYS),
        "loss_burst": dict.fromkeys(("mean", "longest")),
    }
    always = {**dict.fromkeys(("sent", "delivered", "lost", "duplicated", "reordered")),
              "rejected": {}, "measured_ms": percentiles(delays_ms)}  # fmt: skip
    found = {**always, **(counts or unknown)}
    return Channel(**{k: v for k, v in found.items() if k != "curves"})  # for the report alone
