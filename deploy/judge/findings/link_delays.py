"""One-way delays of the link between controller and plant, as a run measured them itself."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector, percentiles
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.recorded_ticks import longest_run
from deploy.judge.run_data import RunData, stamps_s

_Z_95 = 1.959963984540054


class MeasuredDelays(NamedTuple):
    """The messages of one direction, in the order of sending.

    Attributes:
        sent_s: when each was sent, shape (messages,).
        delays_ms: how long it took, NaN where it was lost; shape (messages,).
    """

    sent_s: Vector
    delays_ms: Vector

    @property
    def lost(self) -> int:
        return int(np.isnan(self.delays_ms).sum())

    def summary(self, reordered: int | None = None) -> str:
        """Return what was measured in a line; None for an unknown order."""
        found = percentiles(self.delays_ms[~np.isnan(self.delays_ms)])
        span_s = float(np.ptp(self.sent_s))
        longest = longest_run(np.isnan(self.delays_ms))
        return link_sentence(len(self.sent_s), span_s, self.lost, longest, found, reordered)


def measured_link(run: RunData) -> dict[str, MeasuredDelays]:
    """Return the messages that arrived, by direction: over bus, emulated link and any real delay.

    An uplink delay lasts from the measurement to the start of the controller's cycle, a downlink
    delay from the end of that cycle to the command's arrival at the joints. Both are empty in
    virtual time, if the processes had different clocks, or if the recording lacks a cycle.
    """
    plant, controller = (
        run.last_values(role, EventKind.ENDED) for role in (Role.PLANT, Role.CONTROLLER)
    )
    status, truth = (
        run.tables[topic.name] for topic in (topics.CONTROL_STATUS, topics.PLANT_TRUTH)
    )
    has_one_clock = plant.get("kernel", 0) == controller.get("kernel") != 0
    has_times = {"newest_cycle_s", "cycles"} <= controller.keys() and "start_s" in plant
    if not (
        run.clock == "realtime" and has_one_clock and has_times  # events may come from anyone
        and status.size == controller["cycles"]
        and np.array_equal(status["timing.cycle"], np.arange(status.size))
    ):  # fmt: skip
        return dict.fromkeys(("uplink", "downlink"), MeasuredDelays(np.zeros(0), np.zeros(0)))
    periods_ns, stamps_ns = status["timing.period_ns"], 1e9 * stamps_s(status)
    newest_ns = 1e9 * (controller["newest_cycle_s"] - plant["start_s"])
    started_ns = newest_ns + np.cumsum(periods_ns) - periods_ns.sum()
    arrived = (truth["round_trip_ns"] >= 0) & np.isin(truth["command_sequence"], status["sequence"])
    of = np.searchsorted(status["sequence"], truth["command_sequence"][arrived])
    arrivals_ns = stamps_ns[of] + truth["round_trip_ns"][arrived]
    sent_ns = (started_ns + status["timing.step_ns"])[of]
    up_ms = (started_ns - stamps_ns) / 1e6
    down_ms = np.maximum(arrivals_ns - sent_ns, 0.0) / 1e6  # a cycle ends after sending
    return {
        "uplink": MeasuredDelays(stamps_ns / 1e9, up_ms),
        "downlink": MeasuredDelays(sent_ns / 1e9, down_ms),
    }


def link_sentence(
    messages: int, duration_s: float, lost: int, longest_loss: int | None,
    delays_ms: dict[str, Any], reordered: int | None,
) -> str:  # fmt: skip
    """Return what is known of a direction in a line: `link`, `trace import` and runs say the same.

    Args:
        messages: sent.
        duration_s: time in which they were sent.
        lost: of them.
        longest_loss: most of them in a row; None for unknown.
        delays_ms: percentiles of the others' delays by name; None for unknown.
        reordered: messages that arrived behind a younger one; None for unknown.
    """
    low, high = share_interval(lost, messages)
    in_a_row = f", up to {longest_loss} in a row" if longest_loss else ""
    values = ", ".join(
        f"{name.replace('_', '.')} {value:.3f}"
        for name, value in delays_ms.items() if value is not None
    )  # fmt: skip
    return (
        f"{messages:,} messages in {duration_s:.1f} s, lost {lost} ({100 * low:.2g} to"
        f" {100 * high:.2g} %){in_a_row}, delay in ms: {values}"
        + ("" if reordered is None else f", reordered {reordered}")
    )


def playout_sentence(playout: dict[str, Any]) -> str:
    """Return what is known of a play-out in a line.

    Args:
        playout: section ``transport.playout`` of a summary.
    """
    acted, arrived = (
        f"{number['p50']:.1f} (max {number['max']:.1f})"
        for number in (playout["horizon_ms"], playout["arrival_ms"])
    )
    late, in_a_row = playout["late"], playout["late_in_a_row"]
    return (
        f"play-out: commands acted {acted} ms after their states and arrived after {arrived} ms,"
        f" {late} late" + (f", up to {in_a_row} in a row" if late else "")
    )


def share_interval(count: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval of a share, of one or more."""
    share, spread = count / of, _Z_95 * _Z_95 / of
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = math.sqrt(share * (1.0 - share) * spread + 0.25 * spread * spread) / (1.0 + spread)
    # At the ends of the range they are exact, except for rounding.
    low = 0.0 if count == 0 else max(0.0, middle - half)
    return low, 1.0 if count == of else min(1.0, middle + half)
