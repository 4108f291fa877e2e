"""Reports of processes at the end of their run, checked for plausible types.

Any sender may forge them, and recordings are untrusted: values of another type are left out and
noted, so that they affect nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Field, TypeAdapter, ValidationError

from bus_schema.arrays import PERCENTILES
from bus_schema.messages.run_event import EventKind, RunEvent
from deploy.judge.result.section import Section

_MOST_NOTES = 20
_COUNT = TypeAdapter(Annotated[int, Field(strict=True, ge=0, lt=1 << 53)])
_AMOUNT = TypeAdapter(Annotated[float, Field(strict=True, ge=0, lt=1e15, allow_inf_nan=False)])
_MAYBE = TypeAdapter(
    Annotated[float, Field(strict=True, ge=0, lt=1e15, allow_inf_nan=False)] | None
)
_SLACK = TypeAdapter(Annotated[float, Field(strict=True, allow_inf_nan=False)] | None)
_MARGIN = TypeAdapter(Annotated[float, Field(strict=True, le=1.0, allow_inf_nan=False)] | None)
_TRUTH = TypeAdapter(Annotated[bool, Field(strict=True)])
_MAYBE_TRUTH = TypeAdapter(Annotated[bool, Field(strict=True)] | None)
_COUNTS = TypeAdapter(dict[str, Annotated[int, Field(strict=True, ge=0, lt=1 << 53)]])
_TEXT = TypeAdapter(Annotated[str, Field(max_length=100)])
_ANY = TypeAdapter(dict[str, Any])

_CURVE = TypeAdapter(
    Annotated[list[Annotated[float, Field(allow_inf_nan=False)]], Field(max_length=100)]
)
_STRETCHES = TypeAdapter(
    Annotated[
        list[
            Annotated[
                list[Annotated[float, Field(ge=0, lt=1e15, allow_inf_nan=False)]],
                Field(min_length=2, max_length=2),
            ]
        ],
        Field(max_length=1000),
    ]
)
_FINITE = Annotated[float, Field(ge=-1e15, lt=1e15, allow_inf_nan=False)]
_SWITCHES = TypeAdapter(
    Annotated[
        list[Annotated[list[_FINITE], Field(min_length=4, max_length=4)]], Field(max_length=1000)
    ]
)
_POSITIONS = Annotated[list[_FINITE], Field(max_length=100)]
_TARGETS = TypeAdapter(
    Annotated[
        list[Annotated[list[_POSITIONS], Field(min_length=2, max_length=2)]],
        Field(max_length=1000),
    ]
)
_CURVES = dict.fromkeys(("percentiles_ms", "lags_s", "autocorrelation"), _CURVE)


class Reflex(Section):
    """A stop that the robot's own controller decided.

    Attributes:
        kind: its reason
        time_s: when it stopped
        joint: the joint that caused it; null where none did
    """

    kind: Annotated[str, Field(max_length=100)]
    time_s: Annotated[float, Field(strict=True, ge=0, lt=1e9, allow_inf_nan=False)]
    joint: Annotated[str, Field(max_length=100)] | None


class _Jump(BaseModel):
    jump_rad: _FINITE
    time_s: _FINITE
    joint: Annotated[int, Field(strict=True, ge=0, lt=1000)]
    before_rad: Annotated[list[_FINITE], Field(max_length=1000)]
    after_rad: Annotated[list[_FINITE], Field(max_length=1000)]


_JUMP = TypeAdapter(Annotated[_Jump, AfterValidator(_Jump.model_dump)] | None)
_REFLEXES = TypeAdapter(
    Annotated[list[Annotated[Reflex, AfterValidator(Reflex.model_dump)]], Field(max_length=100)]
)
_CHANNEL = {
    **dict.fromkeys(("sent", "delivered", "lost", "duplicated", "reordered", "resent"), _COUNT),
    "rejected": _COUNTS,
    "delay_ms": dict.fromkeys(("mean", *PERCENTILES), _MAYBE),
    "loss_burst": {"mean": _MAYBE, "longest": _COUNT},
    "curves": {"did": _CURVES, "trace": _CURVES},
}
_PLAYOUT = {
    **dict.fromkeys(("horizon_ms", "arrival_ms"), dict.fromkeys(PERCENTILES, _MAYBE)),
    "least_slack_ms": _SLACK,
    **dict.fromkeys(("late", "late_in_a_row"), _COUNT),
}
_CHUNKS = {
    "states": _COUNT, "switches": _COUNT, "first_switches": _SWITCHES, "largest": _JUMP,
    "first_targets_rad": _TARGETS, "age_ms": {"median": _AMOUNT, "largest": _AMOUNT},
}  # fmt: skip
_EXPECTED: Mapping[str, Mapping[str, Any]] = {
    EventKind.ENDED: {
        "ticks": _COUNT, "completed": _TRUTH, "wall_s": _AMOUNT, "stolen_ms": _AMOUNT,
        "limits": _COUNTS, "physics": _TEXT, "cycles": _COUNT, "seed_used": _MAYBE_TRUTH,
        "kernel": _COUNT, "start_s": _AMOUNT, "newest_cycle_s": _AMOUNT,
        "starved": {"ticks": _COUNT, "stretches_s": _STRETCHES}, "chunks": _CHUNKS,
        "bounds": {"ticks": _COUNT, "outside": _COUNT, "margin_min": _MARGIN},
    },
    EventKind.COUNTS: {
        "uplink": _CHANNEL, "downlink": _CHANNEL, "limits": _COUNTS, "can": _ANY,
        "playout": _PLAYOUT, "reflexes": _REFLEXES, "robot_server": _ANY,
    },
}  # fmt: skip
"""Expected contents of these events: a type, or a mapping of them."""

ReportedValues = dict[tuple[str, str], dict[str, Any]]


def reported_values(events: Iterable[RunEvent]) -> tuple[ReportedValues, list[str]]:
    """Return the last usable value of each expected item, by source and kind, and notes."""
    found: ReportedValues = {}
    notes: dict[str, None] = {}
    for event in events:
        expected = _EXPECTED.get(event.kind)
        if expected is not None:
            where = f"{event.kind} of {event.source[:40]}"
            values = found.setdefault((event.source, event.kind), {})
            _take(values, event.values(), expected, where, notes)
    return found, list(notes)[:_MOST_NOTES]


def _take(
    values: dict[str, Any],
    given: Mapping[str, Any],
    expected: Mapping[str, Any],
    where: str,
    notes: dict[str, None],
) -> None:
    """Copy values of the expected type into `values`, and note the others."""
    for name, kind in expected.items():
        if name not in given:
            continue
        value, place = given[name], f"{where}: {name}"
        try:
            if not isinstance(kind, Mapping):
                values[name] = kind.validate_python(value)
            elif isinstance(value, Mapping):
                _take(values.setdefault(name, {}), value, kind, place, notes)
            else:
                raise TypeError("not a mapping")
        except (TypeError, ValidationError):
            notes[f"{place} cannot be {repr(value)[:40]} and was left out"] = None
