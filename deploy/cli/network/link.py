"""The command `link`: measures a network between two hosts."""

from __future__ import annotations

import contextlib
import socket
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bus_schema.arrays import Vector, percentiles
from bus_schema.errors import InputError
from bus_schema.runtime.clock import utc_text
from bus_schema.runtime.realtime import go_realtime
from deploy.measure.link_probe import MeasuredLink, ProbeTimes, evaluate, probe
from deploy.measure.probe_frames import LEAST_BYTES, MOST_BYTES, ProbeServer
from deploy.measure.trace_output import scenario_lines, write_trace
from deploy.measure.zenoh_socket import zenoh_client, zenoh_server
from deploy.run.exit_codes import FAULT
from deploy.run.stop_signals import StopRequest

_BARS = " ▁▂▃▄▅▆▇█"
_BINS = 40
_CONNECT_S = 5.0


def link(
    host: Annotated[
        str | None,
        typer.Argument(help="Host on which `funnel-hil link --serve` runs.", show_default=False),
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Answer measurements from other hosts.")
    ] = False,
    port: Annotated[
        int, typer.Option(help="Port on HOST; with --serve, port to listen at.")
    ] = 7460,
    rate_hz: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Rate of the messages.")
    ] = 1000.0,
    size: Annotated[int, typer.Option(help="Size of a message in bytes.")] = 256,
    duration_s: Annotated[
        float, typer.Option("--duration", metavar="S", help="Duration of the measurement.")
    ] = 10.0,
    is_tcp: Annotated[bool, typer.Option("--tcp", help="Use TCP instead of UDP.")] = False,
    is_zenoh: Annotated[
        bool, typer.Option("--zenoh", help="Use Zenoh instead of UDP; with --serve too.")
    ] = False,
    out: Annotated[str, typer.Option(help="Prefix of the trace files.")] = "link",
) -> None:
    """Measure one-way delays, losses and order of a network, and write traces for a scenario.

    Run it on the controller's host, with HOST the plant's: messages to HOST are the downlink.
    """
    if (host is None) != serve:
        raise InputError("link: give a HOST, or --serve")
    if is_tcp and is_zenoh:
        raise InputError("link: give --tcp or --zenoh, not both")
    if not (0.0 < rate_hz <= 10_000.0 and LEAST_BYTES <= size <= MOST_BYTES and duration_s > 0.0):
        raise InputError(
            f"link: --rate must be up to 10000 Hz, --size {LEAST_BYTES} to {MOST_BYTES} bytes,"
            " --duration above 0 s"
        )
    go_realtime()
    stop = StopRequest()
    try:
        if host is None:
            _serve(port, stop, is_zenoh=is_zenoh)
            return
        if is_zenoh:
            opened: socket.socket = zenoh_client(host, port, _CONNECT_S)
        else:
            opened = _connected(host, port, socket.SOCK_STREAM if is_tcp else socket.SOCK_DGRAM)
        with opened as way:
            times = probe(way, rate_hz, size, duration_s, lambda: stop.is_set, _show)
        measured = evaluate(times)
    except (OSError, ValueError) as error:
        print(f"error: {host or 'here'}, port {port}: {error}", file=sys.stderr)
        raise typer.Exit(FAULT) from error
    _report(times, measured, out)


def _serve(port: int, stop: StopRequest, *, is_zenoh: bool) -> None:
    if is_zenoh:
        with zenoh_server(port) as messages:
            print(f"answering on port {port}, Zenoh, until stopped", flush=True)
            ProbeServer(messages).run(lambda: stop.is_set)
        return
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams,
        socket.create_server(("", port)) as listener,
    ):
        datagrams.bind(("", port))
        print(f"answering on port {port}, UDP and TCP, until stopped", flush=True)
        ProbeServer(datagrams, listener).run(lambda: stop.is_set)


def _connected(host: str, port: int, kind: int) -> socket.socket:
    family, _, _, _, address = socket.getaddrinfo(host, port, socket.AF_INET, kind)[0]
    way = socket.socket(family, kind)
    way.settimeout(_CONNECT_S)
    way.connect(address)
    if kind == socket.SOCK_STREAM:
        way.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return way


def _show(time_s: float, round_trips_ms: Vector, sent: int) -> None:
    """Show a histogram of the last second in one line, which replaces the previous one."""
    if not sys.stderr.isatty():
        return
    lost = sent - len(round_trips_ms)
    if not len(round_trips_ms):
        print(f"\r{time_s:6.0f} s, {lost} on their way or lost\033[K", end="", file=sys.stderr)
        return
    low, high = round_trips_ms.min(), round_trips_ms.max()
    counts, _ = np.histogram(round_trips_ms, np.linspace(low, max(high, low + 1e-3), _BINS + 1))
    heights = np.ceil(counts / counts.max() * (len(_BARS) - 1)).astype(int)
    bars = "".join(_BARS[height] for height in heights)
    print(
        f"\r{time_s:6.0f} s, round trip {low:.2f} {bars} {high:.2f} ms, {lost} missing\033[K",
        end="", file=sys.stderr, flush=True,
    )  # fmt: skip


def _report(times: ProbeTimes, measured: MeasuredLink, out: str) -> None:
    with contextlib.suppress(OSError):
        print("\r\033[K" if sys.stderr.isatty() else "", end="", file=sys.stderr)
    print(f"first message sent at {utc_text(int(times.sent_ns[0]))}")
    found = percentiles(times.round_trips_ms)
    shown = ", ".join(f"{name.replace('_', '.')} {value:.3f}" for name, value in found.items())
    print(f"round trip in ms: {shown}")
    files = {}
    for name, way, reordered in zip(
        ("downlink", "uplink"), (measured.there, measured.back), measured.reordered, strict=True
    ):
        files[name] = Path(f"{out}_{name}.csv")
        write_trace(way, files[name])
        print(f"{name}: {way.summary(reordered)}")
    if times.has_one_clock:
        print("both sides run under one kernel and have one clock: one-way delays are exact")
    else:
        print(
            f"the other clock is ahead by {measured.offset_ms:.3f} ms and drifts by"
            f" {measured.drift_ppm:.2f} ppm; one-way delays are uncertain by"
            f" {measured.uncertainty_ms:.3f} ms, in opposite senses"
        )
    print("\n".join(scenario_lines(files)))
