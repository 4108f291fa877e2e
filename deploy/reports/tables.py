"""The numbers of a report as HTML. All text is escaped here, in `tile` and `table`."""

from __future__ import annotations

import html
from collections.abc import Collection, Sequence
from typing import Any

from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.percentiles import PERCENTILES
from deploy.runs.run_data import RunData

_ABSENT = "–"
_BEST = ' class="best"'
_SHOWN_EVENTS = 200
_TIMING = {
    "round_trip_us": "Round trip",
    "command_age_us": "Command age",
    "state_age_us": "State age",
    "control_step_us": "Control step",
    "wakeup_lateness_us": "Wake-up lateness",
}
_TRANSPORT = {
    "sent": "Sent",
    "delivered": "Delivered",
    "lost": "Lost",
    "loss_burst.mean": "Lost in a row, mean",
    "loss_burst.longest": "Lost in a row, most",
    "duplicated": "Duplicated",
    "reordered": "Reordered",
    "delay_ms.mean": "Delay, mean (ms)",
    "delay_ms.p50": "Delay, 50\u00a0% (ms)",
    "delay_ms.p99": "Delay, 99\u00a0% (ms)",
    "delay_ms.p99_9": "Delay, 99.9\u00a0% (ms)",
    "delay_ms.max": "Delay, largest (ms)",
}


def number(value: float | None, factor: float = 1.0, unit: str = "") -> str:
    """A value times a factor, to three digits or to the last whole one, and its unit."""
    if value is None:
        return _ABSENT
    scaled = factor * value
    return (f"{scaled:,.0f}" if abs(scaled) >= 1000 else f"{scaled:.3g}") + unit


def percent(value: float | None) -> str:
    """A fraction as per cent; 100 % only where it is exactly that."""
    if value is None:
        return _ABSENT
    return "100 %" if value == 1.0 else f"{min(100 * value, 99.999):.5g} %"


def tile(label: str, value: str, title: str = "") -> str:
    """One labelled value of the banner."""
    hint = f' title="{html.escape(title)}"' if title else ""
    return f"<div{hint}><dt>{html.escape(label)}</dt><dd>{html.escape(value)}</dd></div>"


def table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    kind: str = "numbers",
    best: Collection[tuple[int, int]] = (),
) -> str:
    """A table whose first column names the rows.

    Args:
        header: titles of the columns.
        rows: their cells.
        kind: CSS class of the table.
        best: row and column of the cells to set off.
    """
    head = "".join(f'<th scope="col">{html.escape(cell)}</th>' for cell in header)
    body = []
    for row, (first, *others) in enumerate(rows):
        cells = "".join(
            f"<td{_BEST if (row, column) in best else ''}>{html.escape(cell)}</td>"
            for column, cell in enumerate(others, start=1)
        )
        body.append(f'<tr><th scope="row">{html.escape(first)}</th>{cells}</tr>')
    return (
        f'<div class="scroll"><table class="{kind}"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def banner_tiles(summary: dict[str, Any]) -> str:
    """What was run, and the figures that matter most."""
    return "".join([
        tile("Scenario", summary["scenario"]),
        tile("Law", summary["law"]),
        tile("Clock", summary["clock"]),
        tile("Link", summary["link"]),
        tile("Duration", f"{summary['duration_s']:g} s"),
        tile("Smallest margin", number(summary["bounds"]["margin_min"], 100, " %"),
             "1 − |e| / bound; negative outside the bounds"),
        tile("Success rate", percent(summary["timing"]["success_rate"]),
             "share of the ticks that met their deadline"),
        tile("Digest", summary["digest"][:12], summary["digest"]),
    ])  # fmt: skip


def rms_tiles(summary: dict[str, Any]) -> str:
    """Root mean square of the error of every joint."""
    tracking = summary["tracking"]
    values = tracking["rms_rad"] or [None] * len(tracking["joint_names"])
    return "".join(
        tile(name, number(value, 1e3, " mrad"))
        for name, value in zip(tracking["joint_names"], values, strict=True)
    )


def joint_table(summary: dict[str, Any]) -> str:
    """Errors and torques, a row per joint."""
    tracking, torque = summary["tracking"], summary["torque"]
    columns = {
        "RMS error (mrad)": (tracking["rms_rad"], 1e3),
        "Largest error (mrad)": (tracking["max_abs_rad"], 1e3),
        "Settling time (s)": (tracking["settling_time_s"], 1.0),
        "Settling bound (s)": (tracking["settling_bound_s"], 1.0),
        "RMS torque (N m)": (torque["rms_nm"], 1.0),
        "Peak torque (N m)": (torque["peak_nm"], 1.0),
        "Total variation (N m/s)": (torque["total_variation_nm_per_s"], 1.0),
    }
    if tracking["settling_bound_s"] is None:
        del columns["Settling bound (s)"]
    rows = [
        [name, *(number(of_joint(values, joint), factor) for values, factor in columns.values())]
        for joint, name in enumerate(tracking["joint_names"])
    ]
    return table(["Joint", *columns], rows)


def timing_table(summary: dict[str, Any]) -> str:
    """Percentiles of every timing quantity, µs."""
    timing = summary["timing"]
    rows = [
        [label, *(number(timing[key][percentile]) for percentile in PERCENTILES)]
        for key, label in _TIMING.items()
    ]
    return table(["µs", "50\u00a0%", "99\u00a0%", "99.9\u00a0%", "Largest"], rows)


def health_table(summary: dict[str, Any]) -> str:
    """Deadlines, pace and recording."""
    timing, recorder = summary["timing"], summary["recorder"]
    rows = [
        ["Deadlines missed", number(timing["deadline_misses"])],
        ["Longest run of misses (ticks)", number(timing["deadline_miss_longest_run"])],
        [
            "Ticks with a saturated actuator",
            number(summary["torque"]["saturated_fraction"], 100, " %"),
        ],
        ["Real-time factor", number(summary["real_time_factor"])],
        ["CPU time that a hypervisor took (ms)", number(timing["stolen_ms"])],
        ["Messages recorded", number(recorder["messages"])],
        ["Messages lost by the recorder", number(recorder["lost"])],
        *(
            [f"Lost of {topic}", number(n)]
            for topic, n in (recorder["lost_by_topic"] or {}).items()
        ),
    ]
    return table(["Run", ""], rows)


def transport_table(summary: dict[str, Any]) -> str:
    """What became of the messages, a column per direction."""
    channels = [summary["transport"][name] for name in ("uplink", "downlink")]
    rows = [
        [title, *(number(_value(channel, key)) for channel in channels)]
        for key, title in _TRANSPORT.items()
    ]
    for reason in sorted({reason for channel in channels for reason in channel["rejected"]}):
        counts = (number(channel["rejected"].get(reason, 0)) for channel in channels)
        rows.append([f"Rejected: {reason.replace('_', ' ')}", *counts])
    if not any(channel["rejected"] for channel in channels):
        rows.append(["Rejected", *("0" if channel["sent"] else _ABSENT for channel in channels)])
    return table(["Messages", "Uplink (states)", "Downlink (commands)"], rows)


def _value(values: dict[str, Any], dotted_key: str) -> float | None:
    """A value of nested tables; None where a recording of another version has none."""
    name, _, inner = dotted_key.partition(".")
    found = values.get(name)
    return _value(found or {}, inner) if inner else found


def event_table(run: RunData) -> str:
    """Everything that was announced, in order, but for counts, which have their own table."""
    events = [event for event in run.events if event.kind != EventKind.COUNTS]
    rows = [
        [f"{event.stamp_ns * 1e-9:.3f}", event.source, event.kind, _detail(event)]
        for event in events[:_SHOWN_EVENTS]
    ]
    hidden = len(events) - _SHOWN_EVENTS
    if hidden > 0:
        rows.append(["…", "", "", f"{hidden:,} more"])
    if not rows:
        rows.append([_ABSENT, "", "", "no event was recorded"])
    return table(["Time (s)", "Source", "Event", "Detail"], rows, "events")


def _detail(event: RunEvent) -> str:
    """What an event says: its sentence, or its values as words."""
    values = event.values().items()
    words = (f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}".lower()
             for key, value in values)  # fmt: skip
    return ", ".join(words) or event.detail


def of_joint(values: list[float | None] | float | None, joint: int) -> float | None:
    """One joint's value of a list, or the one value that holds for all joints."""
    return values[joint] if isinstance(values, list) else values
