"""The real loop in real time beside bare round trips, and its wake-ups beside the kernel's."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial

from deploy.benchmarks import cyclictest
from deploy.benchmarks.costs.loop import recorded_run
from deploy.benchmarks.echo import EchoPair
from deploy.benchmarks.measure import Section, interleave, ratio
from deploy.processes.network.links import with_free_endpoints
from deploy.runs.judging.metrics import summarise
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup

LOOP = "round trip of the real loop"
WAKE_UP_P50, WAKE_UP_P99 = (
    "wake-up lateness of the plant, p50",
    "wake-up lateness of the plant, p99",
)
KERNEL_P50, KERNEL_P99 = "cyclictest, p50", "cyclictest, p99"
_PATIENCE_MS = 2000
"""A busy machine may hold up a run for a while; that ends no measurement of medians."""

BARE_ZENOH, SECURED_ZENOH = "bare Zenoh", "Zenoh with TLS and access control"
CALLBACKS = "Zenoh with callbacks"
_TRANSPORTS = {
    BARE_ZENOH: ("zenoh", "zenoh"),
    SECURED_ZENOH: ("zenoh_tls", "zenoh"),
    CALLBACKS: ("zenoh_callbacks", "zenoh"),
    "raw UDP": ("udp", "socket"),
    "pyzmq": ("pyzmq", "zmq"),
    "LCM": ("lcm_udp", "lcm"),
    "CycloneDDS": ("cyclone", "cyclonedds"),
}
"""By name: a module of `transports`, and the library it needs."""


def measure_round_trips(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure a scenario's loop in real time, and everything it can be held against.

    Args:
        scenario: name or path.
        seconds: length of each run; bare round trips are made at its rate, half as long.
        repetitions: how often everything is measured.
    """
    overrides = [
        f"duration_s={seconds}", "clock=realtime", "plant.gui=false",
        f"plant.command_timeout_ms={_PATIENCE_MS}",
    ]  # fmt: skip
    setup = with_free_endpoints(load_setup(scenario, overrides))
    notes = [_NOTE]
    candidates: dict[str, Callable[[], float | Mapping[str, float]]] = {
        LOOP: partial(_loop_us, setup)
    }
    with ExitStack() as stack:
        transports = _start_transports(setup, stack, notes)
        candidates |= {
            name: partial(_round_trip_us, pair, setup, seconds / 2)
            for name, pair in transports.items()
        }
        why_not = cyclictest.why_not()
        if why_not is None:
            candidates["cyclictest"] = partial(_kernel_us, setup.grid.period_ns // 1000, seconds)
        else:
            notes.append(why_not)
        costs = interleave(candidates, repetitions)
    variants = [name for name in (SECURED_ZENOH, CALLBACKS) if name in transports]
    ratios = [ratio(costs, LOOP, name) for name in transports if name not in variants]
    if BARE_ZENOH in transports:
        ratios += [ratio(costs, name, BARE_ZENOH) for name in variants]
    if why_not is None:
        ratios += [ratio(costs, WAKE_UP_P50, KERNEL_P50), ratio(costs, WAKE_UP_P99, KERNEL_P99)]
    return Section("Real time", costs, ratios, notes)


_NOTE = (
    "Medians of each run. The real loop's round trip holds a control step, and decoding on both"
    " sides; bare ones carry the same bytes at the same rate between processes set up alike."
)


def _loop_us(setup: Setup) -> dict[str, float]:
    """Medians of a run in real time."""
    timing = summarise(recorded_run(setup))["timing"]
    lateness_us = timing["wakeup_lateness_us"]
    return {
        LOOP: timing["round_trip_us"]["p50"],
        WAKE_UP_P50: lateness_us["p50"],
        WAKE_UP_P99: lateness_us["p99"],
    }


def _kernel_us(period_us: int, seconds: float) -> dict[str, float]:
    """What a run of `cyclictest` finds."""
    lateness_us = cyclictest.run_cyclictest(period_us, seconds)
    return {KERNEL_P50: lateness_us["p50"], KERNEL_P99: lateness_us["p99"]}


def _start_transports(setup: Setup, stack: ExitStack, notes: list[str]) -> dict[str, EchoPair]:
    """Pairs of processes for all transports that work here; the others are noted."""
    pairs = {}
    for name, (module, library) in _TRANSPORTS.items():
        if importlib.util.find_spec(library) is None:
            notes.append(f"{name} is not installed: pip install -e '.[bench]'")
            continue
        try:
            pair = EchoPair(module, setup.robot.joint_names, realtime=True)
            pairs[name] = stack.enter_context(pair)
        except RuntimeError as error:
            notes.append(f"{name} does not work here: {error}")
    return pairs


def _round_trip_us(pair: EchoPair, setup: Setup, seconds: float) -> float:
    exchanges = max(1, round(seconds * setup.scenario.rate_hz))
    return pair.round_trips_us(exchanges, setup.grid.period_ns).median
