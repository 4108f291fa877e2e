"""The relay of a real delay: a process between two TCP peers that delays every byte.

Unlike an emulated delay, it includes a real connection, with the machine's scheduling, the
transport's own buffers and two separate processes.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from queue import Queue
from typing import Any

import numpy as np

from bus_schema.percentiles import percentiles
from bus_schema.runtime.realtime import go_realtime
from deploy.run.exit_codes import FAULT, FINISHED
from deploy.run.network.real_delay import LONGEST_MS, RelayOptions
from deploy.run.processes.scheduling import report_settings
from deploy.run.processes.status import StatusReporter
from deploy.run.stop_signals import StopRequest, ignore_stops
from deploy.scenario.yaml_files import ScenarioError

_CHUNK_BYTES = 1 << 16
_MOST_CHUNKS = 64
"""Limit of chunks per direction: beyond it, the relay stops reading and the sender has to wait."""
_CONNECT_TIMEOUT_S = 1.0
_LOOK_UP_S = 0.1
"""Period of the check for a stop request."""


def relay(options: RelayOptions, reporter: StatusReporter) -> int:
    """Run a relay between two TCP peers until asked to stop; return the exit code."""
    stop = StopRequest()
    listen, target = tcp_address(options.listen), tcp_address(options.connect)
    if not 0.0 <= options.delay_ms <= LONGEST_MS:
        raise ScenarioError(f"--delay {options.delay_ms:g}: must be 0 to {LONGEST_MS:g} ms")
    report_settings(go_realtime(), reporter)  # threads inherit the signal mask
    family = socket.AF_INET6 if ":" in listen[0] else socket.AF_INET
    try:
        listener = socket.create_server(listen, family=family)
    except OSError as error:
        reporter.report("fault", text=f"cannot listen at {listen[0]}:{listen[1]}: {error}")
        return FAULT
    with listener:
        held_back = DelayRelay(listener, target, round(options.delay_ms * 1e6))
        place = f"{listen[0]}:{listen[1]}"
        reporter.report("note", text=f"holds back by {options.delay_ms:g} ms each way at {place}")
        held_back.run(lambda: stop.is_set)
    ignore_stops()
    reporter.report("result", **held_back.counts())
    return FINISHED


def tcp_address(text: str) -> tuple[str, int]:
    """Return host and port of HOST:PORT.

    Raises:
        ScenarioError: it has another form.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and 0 < int(port) < 1 << 16):
        raise ScenarioError(f"{text!r}: must be HOST:PORT such as 127.0.0.1:7453")
    return host.strip("[]"), int(port)


class DelayRelay:
    """Accepts connections and forwards them; they end with the process.

    Args:
        listener: socket that accepts connections.
        target: host and port that each connection is forwarded to.
        delay_ns: delay of the bytes, each way.
    """

    def __init__(self, listener: socket.socket, target: tuple[str, int], delay_ns: int) -> None:
        self._listener, self._target, self._delay_ns = listener, target, delay_ns
        self._streams: list[DelayedStream] = []
        listener.settimeout(_LOOK_UP_S)

    def run(self, is_stop_requested: Callable[[], bool]) -> None:
        """Relay until asked to stop."""
        while not is_stop_requested():
            with contextlib.suppress(OSError):  # none came, or it was closed again
                near, _ = self._listener.accept()
                _in_thread(self._pass_on, near)

    def counts(self) -> dict[str, Any]:
        """Return the number of forwarded chunks, and percentiles of their lateness, in whole µs."""
        total: Counter[int] = Counter()
        for stream in list(self._streams):
            total.update(stream.lateness_us.copy())
        values = np.array(sorted(total), dtype=np.int64)
        counts = np.array([total[each] for each in values.tolist()], dtype=np.int64)
        return {"chunks": total.total(), "lateness_us": percentiles(values, counts)}

    def _pass_on(self, near: socket.socket) -> None:
        """Relay a connection to its end; if the target refuses it, the peer may try again."""
        with near, contextlib.suppress(OSError):
            far = socket.create_connection(self._target, _CONNECT_TIMEOUT_S)
            with far:
                for each in (near, far):
                    each.settimeout(None)
                    each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                there = DelayedStream(near, far, self._delay_ns)
                back = DelayedStream(far, near, self._delay_ns)
                self._streams += [there, back]
                steps = (there.take_in, there.let_go, back.take_in, back.let_go)
                for thread in [_in_thread(step) for step in steps]:
                    thread.join()


class DelayedStream:
    """One direction of a connection, with a thread for each end.

    Args:
        source: socket to read from.
        sink: socket to write to.
        delay_ns: delay of the bytes.

    Attributes:
        lateness_us: lateness of sent chunks, each value with its count.
    """

    def __init__(self, source: socket.socket, sink: socket.socket, delay_ns: int) -> None:
        self._source, self._sink, self._delay_ns = source, sink, delay_ns
        self._held: Queue[tuple[int, bytes]] = Queue(_MOST_CHUNKS)
        self.lateness_us: Counter[int] = Counter()

    def take_in(self) -> None:
        """Read to the end; a broken connection ends like a closed one, with an empty chunk."""
        chunk = b"some"
        while chunk:
            try:
                chunk = self._source.recv(_CHUNK_BYTES)
            except OSError:
                chunk = b""
            self._held.put((time.monotonic_ns() + self._delay_ns, chunk))

    def let_go(self) -> None:
        """Send each chunk when it is due, then forward the end."""
        chunk = b"some"
        while chunk:
            due_ns, chunk = self._held.get()
            time.sleep(max(due_ns - time.monotonic_ns(), 0) * 1e-9)
            try:
                if not chunk:
                    self._sink.shutdown(socket.SHUT_WR)
                    return
                self._sink.sendall(chunk)
                self.lateness_us[(time.monotonic_ns() - due_ns) // 1000] += 1
            except OSError:  # the receiver has gone: stop reading
                with contextlib.suppress(OSError):
                    self._source.shutdown(socket.SHUT_RD)


def _in_thread(step: Callable[..., None], *arguments: object) -> threading.Thread:
    thread = threading.Thread(target=step, args=arguments, daemon=True)
    thread.start()
    return thread
