"""Timing of a run: ages, round trips, deadlines and stalls."""

from __future__ import annotations

from typing import Annotated

from bus_schema.arrays import Vector, percentiles
from bus_schema.messages import topics
from deploy.judge.findings.stalls import longest_stall_ms
from deploy.judge.recorded_ticks import KnownTicks, longest_run, rows_after_gaps
from deploy.judge.result.section import Column, Section, Spread
from deploy.judge.run_data import RunData, stamps_s


class Timing(Section):
    """Times on the run's clock, but for wall times.

    Attributes:
        round_trip_us: time from a measurement to the arrival of its command (p50, p99, p99_9, max)
        command_age_us: age of the state answered by the command in force, at each tick (p50, p99,
            p99_9, max)
        state_age_us: age of a joint state on delivery (p50, p99, p99_9, max)
        control_step_us: wall time of one step of the controller (p50, p99, p99_9, max)
        wakeup_lateness_us: lateness of the plant's wake-ups, wall time (p50, p99, p99_9, max)
        deadline_misses: ticks whose command answers a state older than ``link.deadline_ms``
        deadline_miss_longest_run: most such ticks in a row
        success_rate: share of deadlines met, by the age of the command alone
        late_ticks: ticks that missed their deadline or were skipped by a late plant
        late_longest_run: most such ticks in a row
        on_time_rate: share of the other ticks; reports show it as deadlines met
        stolen_ms: CPU time that the hypervisor took away; null except in real time
        longest_stall_ms: longest time for which a loop was kept from running; null except in real
            time
    """

    round_trip_us: Spread
    command_age_us: Spread
    state_age_us: Spread
    control_step_us: Spread
    wakeup_lateness_us: Spread
    deadline_misses: Annotated[int, Column()]
    deadline_miss_longest_run: int
    success_rate: Annotated[float | None, Column()]
    late_ticks: int
    late_longest_run: int
    on_time_rate: float | None
    stolen_ms: float | None
    longest_stall_ms: float | None


def timing(run: RunData, known: KnownTicks, stolen_ms: float | None) -> Timing:
    """Return the timing of a run.

    Args:
        run: the run.
        known: its known ticks.
        stolen_ms: CPU time that a hypervisor took away.
    """
    truth = run.tables[topics.PLANT_TRUTH.name]
    missed = truth["deadline_met"] == 0
    late = missed | (truth["timing.lateness_ns"] < 0)  # so a skipped tick says
    misses, late_ticks = int(missed.sum()), int(late.sum())
    after_gaps = rows_after_gaps(run, stamps_s(truth))
    return Timing(
        **{name: percentiles(values_us) for name, values_us in times_us(run).items()},
        deadline_misses=misses,
        deadline_miss_longest_run=longest_run(missed, after_gaps),
        success_rate=1.0 - misses / known.known if known.known else None,
        late_ticks=late_ticks,
        late_longest_run=longest_run(late, after_gaps),
        on_time_rate=1.0 - late_ticks / known.known if known.known else None,
        stolen_ms=stolen_ms if run.clock == "realtime" else None,  # costs nothing elsewhere
        longest_stall_ms=longest_stall_ms(run),
    )


def times_us(run: RunData) -> dict[str, Vector]:
    """Return all values of every measured time, µs, by its name in the summary."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    in_nanoseconds = {
        "round_trip_us": truth["round_trip_ns"],
        "command_age_us": truth["command_age_ns"],
        "state_age_us": truth["state_age_ns"],
        "control_step_us": run.tables[topics.CONTROL_STATUS.name]["timing.step_ns"],
        "wakeup_lateness_us": truth["timing.lateness_ns"],
    }
    # negative: there is none
    return {name: values[values >= 0] * 1e-3 for name, values in in_nanoseconds.items()}
