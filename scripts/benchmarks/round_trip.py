"""The real loop in real time beside bare round trips, and its wake-ups beside the kernel's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial

from deploy.scenario.setup import Setup
from deploy.studies.bench.loop import (
    LOCKSTEP,
    ROUND_TRIP,
    SIMULATE,
    WAKE_UP_P50,
    WAKE_UP_P99,
    lockstep_setup,
    lockstep_us,
    loop_us,
    realtime_setup,
    simulate_us,
)
from deploy.studies.bench.measure import Section, interleave, ratio
from scripts.benchmarks import cyclictest
from scripts.benchmarks.echo import EchoPair, Transport
from scripts.benchmarks.transports.bare import RawUdp, SecuredZenoh, Zenoh

KERNEL_P50, KERNEL_P99 = "cyclictest, p50", "cyclictest, p99"
PING_PONG = "bare Zenoh ping-pong"
_EXCHANGES = 1000

BARE_ZENOH, SECURED_ZENOH = "bare Zenoh", "Zenoh with TLS and access control"
TRANSPORTS: dict[str, type[Transport]] = {
    BARE_ZENOH: Zenoh,
    SECURED_ZENOH: SecuredZenoh,
    "raw UDP": RawUdp,
}


def measure_round_trips(
    scenario: str,
    seconds: float,
    repetitions: int,
    transports: Mapping[str, type[Transport]] = TRANSPORTS,
    variants: Sequence[str] = (SECURED_ZENOH,),
) -> Section:
    """Measure a scenario's loop in real time, and everything it can be held against.

    Args:
        scenario: name or path.
        seconds: length of each run; bare round trips are made at its rate, half as long.
        repetitions: how often everything is measured.
        transports: what else carries the same bytes, as in `TRANSPORTS`.
        variants: which of them are held against bare Zenoh rather than against the loop.
    """
    setup = realtime_setup(scenario, seconds)
    notes = [_NOTE]
    candidates: dict[str, Callable[[], float | Mapping[str, float]]] = {
        ROUND_TRIP: partial(loop_us, setup)
    }
    with ExitStack() as stack:
        pairs = _start(transports, setup, stack, notes)
        candidates |= {
            name: partial(_round_trip_us, pair, setup, seconds / 2) for name, pair in pairs.items()
        }
        why_not = cyclictest.why_not()
        if why_not is None:
            candidates["cyclictest"] = partial(_kernel_us, setup.grid.period_ns // 1000, seconds)
        else:
            notes.append(why_not)
        costs = interleave(candidates, repetitions)
    ratios = [ratio(costs, ROUND_TRIP, name) for name in pairs if name not in variants]
    if BARE_ZENOH in pairs:
        ratios += [ratio(costs, name, BARE_ZENOH) for name in variants if name in pairs]
    if why_not is None:
        ratios += [ratio(costs, WAKE_UP_P50, KERNEL_P50), ratio(costs, WAKE_UP_P99, KERNEL_P99)]
    return Section("Real time", costs, ratios, notes)


_NOTE = (
    "Medians of each run. The real loop's round trip holds a control step, and decoding on both"
    " sides; bare ones carry the same bytes at the same rate between processes set up alike."
)


def measure_lockstep(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure a tick in lockstep beside what it is made of: an exchange, and a simulated tick."""
    setup = lockstep_setup(scenario, seconds)
    with EchoPair(Zenoh, setup.robot.joint_names, realtime=False) as pair:
        costs = interleave(
            {
                SIMULATE: lambda: simulate_us(setup),
                PING_PONG: lambda: pair.round_trips_us(_EXCHANGES).mean,
                LOCKSTEP: lambda: lockstep_us(setup),
            },
            repetitions,
        )
    return Section("Lockstep", costs, [ratio(costs, LOCKSTEP, (PING_PONG, SIMULATE))])


def _kernel_us(period_us: int, seconds: float) -> dict[str, float]:
    """Return the latencies that a run of `cyclictest` finds."""
    lateness_us = cyclictest.run_cyclictest(period_us, seconds)
    return {KERNEL_P50: lateness_us["p50"], KERNEL_P99: lateness_us["p99"]}


def _start(
    transports: Mapping[str, type[Transport]], setup: Setup, stack: ExitStack, notes: list[str]
) -> dict[str, EchoPair]:
    """Pairs of processes for all transports that work here; the others are noted."""
    pairs = {}
    for name, transport in transports.items():
        try:
            pair = EchoPair(transport, setup.robot.joint_names, realtime=True)
            pairs[name] = stack.enter_context(pair)
        except RuntimeError as error:
            notes.append(f"{name} does not work here: {error}")
    return pairs


def _round_trip_us(pair: EchoPair, setup: Setup, seconds: float) -> float:
    exchanges = max(1, round(seconds * setup.scenario.rate_hz))
    return pair.round_trips_us(exchanges, setup.grid.period_ns).median
