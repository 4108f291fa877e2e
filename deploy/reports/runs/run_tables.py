"""The numbers of a run as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any

from bus_schema.arrays import PERCENTILES
from bus_schema.messages.run_event import EventKind, RunEvent
from deploy.judge.findings.stalls import STALL_MS
from deploy.judge.metrics import RunResult
from deploy.judge.run_data import RunData
from deploy.reports.runs import run_numbers
from deploy.reports.tables import ABSENT, Cell, Column, Table, Value, scaled, table_of
from deploy.run.confirmation import NEAR_ZERO
from deploy.run.processes.status import in_words

Row = list[Cell | Value]

_SHOWN_EVENTS = 200
_REJECTED = (
    "Sent are all messages that entered the link. This leaves out commands that were rejected on"
    " arrival, but not those that were overtaken or came after the arm had stopped."
)
WALL_TIME = "Control step and wake-up lateness are wall time, the others are on the run's clock."
PERCENTILE_NAMES = {name: name.replace("_", ".") for name in PERCENTILES}
_RESENT = "resent"
"""Key that only directions over TCP have."""
_TRANSPORT = {
    "sent": "Sent",
    "delivered": "Delivered",
    "lost": "Lost",
    "loss_burst.mean": "Lost in a row, mean",
    "loss_burst.longest": "Lost in a row, maximum",
    "duplicated": "Duplicated",
    "reordered": "Reordered",
    _RESENT: "Sent again",
    "delay_ms.mean": "Delay, mean (ms)",
    **{f"delay_ms.{name}": f"Delay, {title} (ms)" for name, title in PERCENTILE_NAMES.items()},
    **{
        f"measured_ms.{name}": f"Delay with the bus, {title} (ms)"
        for name, title in PERCENTILE_NAMES.items()
    },
}


def joint_table(result: RunResult, from_s: float, slides: Sequence[bool]) -> Table:
    """Errors (from `from_s` on) and torques of a run, a row per joint; some joints slide."""
    shown = [
        (quantity.column, quantity.of_joints(result))
        for quantity in run_numbers.OF_ONE_RUN
        if quantity is not run_numbers.SETTLING_BOUND or quantity.given(result)
    ]
    names = [
        f"{name} (mm, N)" if is_sliding else name
        for name, is_sliding in zip(result.tracking.joint_names, slides, strict=True)
    ]
    return Table(
        f"Joints, errors from {from_s:g} s on, torques of the whole run",
        [Column("Joint", is_text=True), *(column for column, _ in shown)],
        list(zip(names, *(values for _, values in shown), strict=True)),
        run_numbers.SETTLED,
        None if result.ticks else 0,
    )


def timing_table(result: RunResult) -> Table:
    """Percentiles of every timing quantity; the longest stall too, where it was a long one.

    Quantities that were always 0, as in virtual time, are named in the note.
    """
    stall_ms = result.timing.longest_stall_ms
    stalls: list[list[Value]] = (
        [["Longest stall", *[None] * (len(PERCENTILES) - 1), 1e3 * stall_ms]]
        if stall_ms is not None and stall_ms > STALL_MS
        else []
    )
    times = {
        title: [getattr(result.timing, key)[name] for name in PERCENTILE_NAMES]
        for key, title in run_numbers.TIMES.items()
    }
    always_0 = [title for title, values in times.items() if not any(v != 0 for v in values)]
    always = f" All samples are 0: {', '.join(always_0).lower()}." if always_0 else ""
    return Table(
        "Timing",
        [
            Column("Time", is_text=True),
            *(Column(title, "µs") for title in PERCENTILE_NAMES.values()),
        ],
        [[title, *values] for title, values in times.items() if title not in always_0] + stalls,
        WALL_TIME + always,
        None if result.ticks else 0,
    )


def health_table(result: RunResult) -> Table:
    """Every number of a run as a whole."""
    skipped = result.recording.ticks_skipped
    rows: list[Row] = []
    if skipped:
        rows += [["Ticks", result.ticks], ["Ticks skipped by a late plant", skipped]]
    rows += number_rows(run_numbers.RUN_NUMBERS, [result])
    lost = result.recorder.lost_by_topic or {}
    rows += [[f"Lost of {topic}", count] for topic, count in lost.items()]
    return Table("Health", [Column("Run", is_text=True), Column("")], rows, most_printed=0)


_PLAYOUT = {
    "arrival_ms.p50": "Arrival after the state, p50 (ms)",
    "arrival_ms.max": "Arrival after the state, max (ms)",
    "horizon_ms.p50": "Play-out, p50 (ms)",
    "horizon_ms.max": "Play-out, max (ms)",
    "least_slack_ms": "Smallest slack (ms)",
    "late": "Later than the play-out",
    "late_in_a_row": "Later, in a row, maximum",
}


def transport_table(result: RunResult) -> Table:
    """Return the table of messages, a column per direction."""
    channels = [result.transport.uplink, result.transport.downlink]
    rows: list[list[Value]] = [
        [title, *(_value(channel.model_dump(), key) for channel in channels)]
        for key, title in _TRANSPORT.items()
        if key != _RESENT or any(channel.resent is not None for channel in channels)
    ]
    for reason in sorted({reason for channel in channels for reason in channel.rejected}):
        counts = (channel.rejected.get(reason, 0) for channel in channels)
        rows.append([f"Rejected: {reason.replace('_', ' ')}", *counts])
    if not any(channel.rejected for channel in channels):
        rows.append(["Rejected", *(0 if channel.sent else None for channel in channels)])
    playout = result.transport.playout or {}
    rows += [[title, None, _value(playout, key)] for key, title in _PLAYOUT.items() if playout]
    columns = (Column("Messages", is_text=True), Column("Uplink (states)"))
    note = _REJECTED if any(channel.rejected for channel in channels) else ""
    return Table("Transport", [*columns, Column("Downlink (commands)")], rows, note, 0)


def event_table(run: RunData) -> Table:
    """Everything that was announced, in order, but for counts and a policy server's answers."""
    hidden_kinds = (EventKind.COUNTS, EventKind.ANSWER)
    events = [event for event in run.events if event.kind not in hidden_kinds]
    rows = [
        [f"{event.stamp_ns * 1e-9:.3f}", event.source, event.kind, _detail(event)]
        for event in events[:_SHOWN_EVENTS]
    ]
    hidden = len(events) - _SHOWN_EVENTS
    if hidden > 0:
        rows.append(["…", "", "", f"{hidden:,} more"])
    if not rows:
        rows.append([ABSENT, "", "", "no events were recorded"])
    headings = ("Time (s)", "Source", "Event", "Detail")
    columns = [Column(heading, is_text=True) for heading in headings]
    return Table("Events", columns, rows, most_printed=0)


def confirmation_tables(confirmations: Iterable[Any]) -> list[Table]:
    """Return the table of all confirmations of some results; none where there is no confirmation.

    Args:
        confirmations: ``confirmation`` of each result; None for none.
    """
    found = [each for some in confirmations for each in some or ()]
    if not found:
        return []
    scenarios = {each["scenario"] for each in found}
    columns: list[tuple[Column, Callable[[Mapping[str, Any]], Cell | Value]]] = [
        (Column("Scenario", brief="" if len(scenarios) > 1 else None, is_text=True),
         itemgetter("scenario")),
        (Column("Law", is_text=True), itemgetter("law")),
        (Column("On", is_text=True), itemgetter("physics")),
        (Column("Runs"), itemgetter("runs")),
        (Column("Same verdict", brief="Same"), itemgetter("agree")),
        (Column("Different verdict", brief="Other"),
         lambda each: Cell(each["differ"], "bad" if each["differ"] else "")),
        (Column("Too close to call", brief="Near"), itemgetter("too_near")),
        (Column("Smallest margins differ by at most", "%", "Margin\n±"),
         lambda each: scaled(each["margin_difference"], 100.0)),
        (Column("True errors differ by at most", "mrad", "Error\n±"),
         lambda each: scaled(each["error_difference_rad"], 1e3)),
    ]  # fmt: skip
    return [
        table_of(
            "Confirmation on other physics", columns, found,
            "The same runs with the same controller, link and actuators, on the other physics"
            " engine. A different verdict is too close to call if a smallest margin is within"
            f" {NEAR_ZERO:.0%} of the bound from zero.",
        )
    ]  # fmt: skip


def number_rows(
    numbers: Mapping[str, Callable[[RunResult], Value]], results: Sequence[RunResult]
) -> list[Row]:
    """A row for each number, such as `run_numbers.RUN_NUMBERS`, with a value for each run."""
    return [[heading, *map(of, results)] for heading, of in numbers.items()]


def _value(values: dict[str, Any], dotted_key: str) -> float | None:
    """A value of nested tables; None where a recording of another version has none."""
    name, _, inner = dotted_key.partition(".")
    found = values.get(name)
    return _value(found or {}, inner) if inner else found


def _detail(event: RunEvent) -> str:
    """Return an event's sentence, or its values as words."""
    return in_words(event.values()) or event.detail
