"""Bare round trips between two processes, over whatever carries bytes.

The messages are those of the real loop: a plant status and a joint state one way, a joint command
back; nothing is decoded, nothing recorded. Both ends are processes of their own, set up as those of
a run are. Run as a module, this is one of them.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np

from bus_schema.messages import topics
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.runtime.realtime import go_realtime, sleep_lightly, use_batch_scheduling

TIMEOUT_S = 10.0
"""For anything that should come at once."""

_WARM_UP = 200
_TRY_S = 0.1


class Messages(NamedTuple):
    """Wire bytes of one exchange."""

    status: bytes
    state: bytes
    command: bytes


class NearEnd(Protocol):
    """The end that asks. Every transport's module has a `Near` like this, and `answer`.

    Attributes:
        address: what the far end has to know.
    """

    address: str

    def await_far_end(self) -> None:
        """Return once exchanges work."""

    def exchange(self) -> None:
        """Send a status and a state, and wait for the command."""


class TryingNearEnd(ABC):
    """A near end that tries until the far end answers, as nothing tells it when that is there.

    Attributes:
        address: what the far end has to know.
    """

    address: str

    def await_far_end(self) -> None:
        give_up_s = time.monotonic() + TIMEOUT_S
        while not self._try(_TRY_S):
            if time.monotonic() > give_up_s:
                raise TimeoutError("the two ends do not find each other")
        while self._took(_TRY_S):
            pass  # late answers to earlier tries

    def exchange(self) -> None:
        if not self._try(TIMEOUT_S):
            raise TimeoutError("a message was lost")

    def _try(self, timeout_s: float) -> bool:
        self._send()
        return self._took(timeout_s)

    @abstractmethod
    def _send(self) -> None:
        """Send a status and a state."""

    @abstractmethod
    def _took(self, timeout_s: float) -> bool:
        """Take a command; whether one came in time."""


class RoundTrips(NamedTuple):
    """Round trips in µs."""

    median: float
    mean: float


class EchoPair:
    """Two processes that exchange messages.

    Args:
        transport: name of a module in `deploy.benchmarks.transports`.
        joint_names: joints of the arm whose messages are sent.
        realtime: set both processes up as those of a run in real time, or else in lockstep.
    """

    def __init__(self, transport: str, joint_names: tuple[str, ...], *, realtime: bool) -> None:
        words = [transport, "realtime" if realtime else "lockstep", *joint_names]
        self._near = subprocess.Popen(
            [sys.executable, "-m", "deploy.benchmarks.echo", "near", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    @property
    def near_pid(self) -> int:
        """Process id of the end that asks; the other one is its only child."""
        return self._near.pid

    def __enter__(self) -> EchoPair:
        self.round_trips_us(_WARM_UP)
        return self

    def __exit__(self, *_: object) -> None:
        self._near.communicate()

    def round_trips_us(self, exchanges: int, period_ns: int = 0) -> RoundTrips:
        """Measure.

        Args:
            exchanges: how many.
            period_ns: time from the start of one to the start of the next; 0 for no pause.

        Raises:
            RuntimeError: the processes failed.
        """
        assert self._near.stdin is not None
        assert self._near.stdout is not None
        try:
            self._near.stdin.write(f"{exchanges} {period_ns}\n")
            self._near.stdin.flush()
            return RoundTrips(**json.loads(self._near.stdout.readline()))
        except (OSError, ValueError) as error:
            raise RuntimeError("the processes of a ping-pong failed") from error


def joint_messages(joint_names: tuple[str, ...]) -> Messages:
    """The messages of an arm."""
    carried = (topics.PLANT_STATUS, topics.JOINT_STATES, topics.JOINT_COMMANDS)
    return Messages(*(topics.layout(topic, joint_names).template for topic in carried))


def measure(near: NearEnd, exchanges: int, period_ns: int) -> RoundTrips:
    """Exchange messages on a grid of time, and take the time of each."""
    clock, times_ns = MonotonicClock(), np.empty(exchanges)
    for index in range(exchanges):
        clock.wait_until(index * period_ns)
        started_ns = time.perf_counter_ns()
        near.exchange()
        times_ns[index] = time.perf_counter_ns() - started_ns
    return RoundTrips(float(np.median(times_ns)) * 1e-3, float(times_ns.mean()) * 1e-3)


def _ask(transport: ModuleType, words: list[str], messages: Messages) -> None:
    """Be the near end: measure whatever standard input asks for."""
    near: NearEnd = transport.Near(messages)
    command = [sys.executable, "-m", "deploy.benchmarks.echo", "far", *words, near.address]
    far = subprocess.Popen(command, stdin=subprocess.PIPE)
    near.await_far_end()
    for line in sys.stdin:
        exchanges, period_ns = map(int, line.split())
        print(json.dumps(measure(near, exchanges, period_ns)._asdict()), flush=True)
    far.communicate()
    os._exit(0)  # some transports have threads that never end


def _end_with_standard_input() -> None:
    def wait() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


def main() -> None:
    """Be one of the two ends: ``near|far TRANSPORT realtime|lockstep JOINT… [ADDRESS]``."""
    role, name, scheduling, *rest = sys.argv[1:]
    if scheduling == "realtime":
        go_realtime()
    else:
        use_batch_scheduling()
        sleep_lightly()
    transport = importlib.import_module(f"deploy.benchmarks.transports.{name}")
    if role == "near":
        _ask(transport, sys.argv[2:], joint_messages(tuple(rest)))
    else:
        _end_with_standard_input()
        transport.answer(rest[-1], joint_messages(tuple(rest[:-1])))


if __name__ == "__main__":
    main()
