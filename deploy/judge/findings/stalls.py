"""Stalls: times for which a loop in real time was kept from its work."""

from __future__ import annotations

from bus_schema.messages import topics
from deploy.judge.recorded_ticks import longest_run, rows_after_gaps
from deploy.judge.run_data import RunData, stamps_s

STALL_MS = 20.0
"""Longer stalls are reported: no loop, garbage collector or ordinary scheduler takes that long."""


def longest_stall_ms(run: RunData) -> float | None:
    """Return the longest stall in the recording; None in virtual time, which has none.

    It is the largest of: the plant's wake-up lateness; consecutive ticks that it missed; a step of
    the controller; and the time between two states at the controller beyond that between their
    stamps, minus the emulated link's part, which shows delays by a host or a transport. A stall
    that shows in none of them had no effect.
    """
    if run.clock != "realtime":
        return None
    truth = run.tables[topics.PLANT_TRUTH.name]
    lateness_ns, after_gaps = truth["timing.lateness_ns"], rows_after_gaps(run, stamps_s(truth))
    steps_ns = run.tables[topics.CONTROL_STATUS.name]["timing.step_ns"]
    stalls_ns = (
        int(lateness_ns.max(initial=0)),
        longest_run(lateness_ns < 0, after_gaps) * run.setup.grid.period_ns,
        int(steps_ns.max(initial=0)),
        _longest_hold_up_ns(run),
    )
    return max(stalls_ns) * 1e-6


def _longest_hold_up_ns(run: RunData) -> float:
    """Return the largest delay between two states beyond the time between their stamps."""
    status = run.tables[topics.CONTROL_STATUS.name]
    ages_ns = run.tables[topics.PLANT_TRUTH.name]["state_age_ns"]
    if len(status) < 2:
        return 0.0
    stamps_ns = 1e9 * stamps_s(status)
    cycles = status["timing.cycle"].astype("int64")
    follows = cycles[1:] - cycles[:-1] == 1  # else one is missing, or a new controller joined
    excess_ns = status["timing.period_ns"][1:] - (stamps_ns[1:] - stamps_ns[:-1])
    delivered_ns = ages_ns[ages_ns >= 0]
    emulated_ns = float(delivered_ns.max() - delivered_ns.min()) if len(delivered_ns) else 0.0
    return max(float(excess_ns[follows].max(initial=0.0)) - emulated_ns, 0.0)
