"""The real loop in real time beside bare round trips, and its wake-ups beside the kernel's."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

from deploy.benchmarks import cyclictest
from deploy.benchmarks.echo import EchoPair
from deploy.benchmarks.loop_costs import recorded_run
from deploy.benchmarks.measure import Section, interleave, ratio
from deploy.processes.endpoints import with_free_endpoints
from deploy.runs.metrics import summarise
from deploy.scenario.scenario import Setup, load_setup

LOOP = "round trip of the real loop"
WAKE_UP_P50, WAKE_UP_P99 = (
    "wake-up lateness of the plant, p50",
    "wake-up lateness of the plant, p99",
)
KERNEL_P50, KERNEL_P99 = "cyclictest, p50", "cyclictest, p99"
_PATIENCE_MS = 2000
"""A busy machine may hold up a run for a while; that ends no measurement of medians."""

BARE_ZENOH, SECURED_ZENOH = "bare Zenoh", "Zenoh with TLS and access control"
_TRANSPORTS = {
    BARE_ZENOH: ("zenoh", "zenoh"),
    SECURED_ZENOH: ("zenoh_tls", "zenoh"),
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
    loop, notes = _RealLoop(setup), [_NOTE]
    candidates: dict[str, Callable[[], float]] = {
        LOOP: loop.round_trip_us, WAKE_UP_P50: partial(loop.lateness_us, "p50"),
        WAKE_UP_P99: partial(loop.lateness_us, "p99"),
    }  # fmt: skip
    with ExitStack() as stack:
        transports = _start_transports(setup, stack, notes)
        candidates |= {
            name: partial(_round_trip_us, pair, setup, seconds / 2)
            for name, pair in transports.items()
        }
        why_not = cyclictest.why_not()
        if why_not is None:
            kernel = _Kernel(setup.grid.period_ns // 1000, seconds)
            candidates |= {KERNEL_P50: kernel.p50_us, KERNEL_P99: kernel.p99_us}
        else:
            notes.append(why_not)
        costs = interleave(candidates, repetitions)
    ratios = [ratio(costs, LOOP, name) for name in transports if name != SECURED_ZENOH]
    if {BARE_ZENOH, SECURED_ZENOH} <= transports.keys():
        ratios.append(ratio(costs, SECURED_ZENOH, BARE_ZENOH))
    if why_not is None:
        ratios += [ratio(costs, WAKE_UP_P50, KERNEL_P50), ratio(costs, WAKE_UP_P99, KERNEL_P99)]
    return Section("Real time", costs, ratios, notes)


_NOTE = (
    "Medians of each run. The real loop's round trip holds a control step, and decoding on both"
    " sides; bare ones carry the same bytes at the same rate between processes set up alike."
)


class _RealLoop:
    """Runs in real time; one run gives all its numbers."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._timing: dict[str, Any] = {}

    def round_trip_us(self) -> float:
        """Median round trip of a new run."""
        self._timing = summarise(recorded_run(self._setup))["timing"]
        return float(self._timing["round_trip_us"]["p50"])

    def lateness_us(self, percentile: str) -> float:
        """Wake-up lateness of the newest run."""
        return float(self._timing["wakeup_lateness_us"][percentile])


class _Kernel:
    """Runs of `cyclictest`; one run gives both its numbers."""

    def __init__(self, period_us: int, seconds: float) -> None:
        self._period_us, self._seconds = period_us, seconds
        self._newest = cyclictest.Lateness(0.0, 0.0)

    def p50_us(self) -> float:
        """Median of a new run."""
        self._newest = cyclictest.run_cyclictest(self._period_us, self._seconds)
        return self._newest.p50

    def p99_us(self) -> float:
        """99 % of the newest run."""
        return self._newest.p99


def _start_transports(setup: Setup, stack: ExitStack, notes: list[str]) -> dict[str, EchoPair]:
    """Pairs of processes for all transports that work here; the others are noted."""
    pairs = {}
    for name, (module, library) in _TRANSPORTS.items():
        if importlib.util.find_spec(library) is None:
            notes.append(f"{name} is not installed: pip install 'funnel-hil[bench]'")
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
