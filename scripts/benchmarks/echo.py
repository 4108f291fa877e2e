"""Bare round trips between two processes, over any transport of bytes.

The messages are those of the real loop: a plant status and a joint state one way, a joint command
back; nothing is decoded, nothing recorded. Both ends are processes of their own, set up as those of
a run are.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from multiprocessing.connection import Connection, wait
from typing import NamedTuple

import numpy as np

from bus_schema.messages import topics
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.runtime.realtime import go_realtime, sleep_lightly, use_batch_scheduling

TIMEOUT_S = 60.0
"""For anything that should come at once: on a busy machine, processes take long to start."""

_WARM_UP = 200
_TRY_S = 0.1


class Messages(NamedTuple):
    """Wire bytes of one exchange."""

    status: bytes
    state: bytes
    command: bytes


class Transport(ABC):
    """The end that asks, made in its own process; `answer` is the other end.

    Args:
        messages: what is carried.

    Attributes:
        address: what the far end has to know.
    """

    address: str

    @abstractmethod
    def __init__(self, messages: Messages) -> None: ...

    @staticmethod
    @abstractmethod
    def answer(address: str, messages: Messages) -> None:
        """Be the far end: answer every state, without end."""

    @abstractmethod
    def await_far_end(self) -> None:
        """Return once exchanges work."""

    @abstractmethod
    def exchange(self) -> None:
        """Send a status and a state, and wait for the command."""


class TryingTransport(Transport):
    """Tries until the far end answers, as nothing reports when that is there."""

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
        transport: what carries them.
        joint_names: joints of the arm whose messages are sent.
        realtime: set both processes up as those of a run in real time, or else in lockstep.
    """

    def __init__(
        self, transport: type[Transport], joint_names: tuple[str, ...], *, realtime: bool
    ) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._far_end = (transport, joint_messages(joint_names), realtime)
        self._line, near_line = self._context.Pipe()
        near = self._context.Process(target=_ask, args=(*self._far_end, near_line), daemon=True)
        near.start()
        near_line.close()  # so that its end is noticed here
        self._processes = [near]

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of both ends, ``near`` and ``far``."""
        names = ("near", "far")
        return {name: one.pid or 0 for name, one in zip(names, self._processes, strict=True)}

    def __enter__(self) -> EchoPair:
        try:
            arguments = (*self._far_end, self._received())
            self._processes.append(
                self._context.Process(target=_answer, args=arguments, daemon=True)
            )
            self._processes[-1].start()
            self.round_trips_us(_WARM_UP)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()  # some transports have threads that never end
            process.join()

    def round_trips_us(self, exchanges: int, period_ns: int = 0) -> RoundTrips:
        """Measure.

        Args:
            exchanges: how many.
            period_ns: time from the start of one to the start of the next; 0 for no pause.

        Raises:
            RuntimeError: the processes failed.
        """
        self._line.send((exchanges, period_ns))
        return RoundTrips(*self._received())

    def _received(self) -> tuple[float, ...] | str:
        try:
            return self._line.recv()  # type: ignore[no-any-return]
        except (OSError, EOFError) as error:
            raise RuntimeError("the processes of a ping-pong failed") from error


def joint_messages(joint_names: tuple[str, ...]) -> Messages:
    """The messages of an arm."""
    carried = (topics.PLANT_STATUS, topics.JOINT_STATES, topics.JOINT_COMMANDS)
    return Messages(*(topics.layout(topic, joint_names).template for topic in carried))


def measure(near: Transport, exchanges: int, period_ns: int) -> RoundTrips:
    """Exchange messages on a grid of time, and take the time of each."""
    clock, times_ns = MonotonicClock(), np.empty(exchanges)
    for index in range(exchanges):
        clock.wait_until(index * period_ns)
        started_ns = time.perf_counter_ns()
        near.exchange()
        times_ns[index] = time.perf_counter_ns() - started_ns
    return RoundTrips(float(np.median(times_ns)) * 1e-3, float(times_ns.mean()) * 1e-3)


def _ask(transport: type[Transport], messages: Messages, realtime: bool, line: Connection) -> None:
    """Be the near end: print its address, then measure on request."""
    _begin(realtime)
    near = transport(messages)
    line.send(near.address)
    near.await_far_end()
    while True:
        exchanges, period_ns = line.recv()
        line.send(measure(near, exchanges, period_ns))


def _answer(transport: type[Transport], messages: Messages, realtime: bool, address: str) -> None:
    _begin(realtime)
    transport.answer(address, messages)


def _begin(realtime: bool) -> None:
    """Set this process up like one of a run, and end it with the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    if realtime:
        go_realtime()
    else:
        use_batch_scheduling()
        sleep_lightly()


def _end_with(parent: int) -> None:
    wait([parent])
    os._exit(0)
