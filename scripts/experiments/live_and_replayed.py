"""A loop over a real link, and traces that `funnel-hil link` measured of it replayed beside it.

``python -m scripts.experiments.live_and_replayed FIRST LAST [SCALE]`` makes two network namespaces.
The plant runs in one and the controller in the other, in real time over Zenoh (TCP) and a relay,
which plays a bursty trace, while other traffic crosses the same cable. `link` measures the same
network, through a second relay with the same trace and start: once before the run, and once beside
it. Each trace is then replayed in virtual time. It prints a row for each seed. Root is needed.
"""

from __future__ import annotations

import datetime as dt
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.findings.link_delays import MeasuredDelays, measured_link
from deploy.measure.trace_output import write_trace
from deploy.run.execute import InProcess, JudgedRun, execute
from deploy.run.exit_codes import BAD_INPUT
from deploy.run.run_folder import load_run, read_summary
from deploy.scenario.scenario import load_setup
from plant_emulator.channel.trace_file import read_trace
from scripts.experiments.two_hosts import Host, await_line, two_hosts

SETTINGS = [
    "duration_s=8", "controller.delay_compensation.enabled=true", "link.deadline_ms=100",
    "controller.delay_compensation.expected_round_trip_ms=12", "plant.command_timeout_ms=1000",
]  # fmt: skip
RATE_HZ, SIZE, BEFORE_S = 1000, 256, 10.0
TRAFFIC_BYTES, PAUSE_S = 20_000, 0.01
_PLANT, _CONTROLLER, _RELAY, _SERVER, _SERVER_RELAY = range(7451, 7456)
_LAST_LINE = "uplink: {trace"
"""In the last line of `link`."""
_LEAD_S = 0.0003
"""A replayed command is sent without the step of the controller, which takes less than this."""


class Live(NamedTuple):
    """A run over the network, and what was measured of it.

    Attributes:
        summary: content of its ``summary.json``.
        traces: prefixes of files, and how long after their first message the run began, s.
    """

    summary: Mapping[str, Any]
    traces: Mapping[str, tuple[Path, float]]


class Network(NamedTuple):
    """Two hosts, between which a relay plays a trace.

    Attributes:
        plant: host of the plant.
        controller: host of the controller and of the relay.
        seed: of the relay: where in the trace it begins.
        scale: of the delays.
    """

    plant: Host
    controller: Host
    seed: int
    scale: float

    @contextmanager
    def relay(self, port: int, target_port: int) -> Iterator[float]:
        """Relay from a port of the controller's host to one of the plant's; when it began, s."""
        words = settings(
            f"seed={self.seed}", "link.downlink.delay_ms=4",
            f"link.uplink.trace={{file: 5g, scale: {self.scale}}}",
        )  # fmt: skip
        ends = f"{self.controller.address}:{port}", f"{self.plant.address}:{target_port}"
        with self.controller.command("relay", *ends, *words) as process:
            yield instant_s(await_line(process, "relaying"))

    def run(self, folder: Path) -> None:
        """Run the loop, recorder and all, to its end."""
        endpoint = "link.plant_endpoint=tcp/{}:{}".format
        words = [
            "paper_arm", "--await-recorder", *settings(
                *SETTINGS, "clock=realtime",
                f"link.controller_endpoint=tcp/{self.controller.address}:{_CONTROLLER}",
            ),
        ]  # fmt: skip
        direct = settings(endpoint(self.plant.address, _PLANT))
        relayed = settings(endpoint(self.controller.address, _RELAY))
        recording = [each for each in words if each != "--await-recorder"]
        with (
            self.plant.command("record", *recording, *direct, "--out", folder) as recorder,
            self.plant.command("plant", *words, *direct) as plant,
            self.controller.command("controller", *words, *relayed) as controller,
        ):
            for process in (recorder, plant, controller):
                output, _ = process.communicate()
                if process.returncode == BAD_INPUT:
                    raise RuntimeError(output)

    def probe(self, out: Path, *options: object) -> Any:
        """Start `funnel-hil link` through its relay, over Zenoh as the loop."""
        return self.controller.command(
            "link", self.controller.address, "--zenoh", "--port", _SERVER_RELAY,
            "--rate", RATE_HZ, "--size", SIZE, "--out", out, *options,
        )  # fmt: skip


def settings(*overrides: str) -> list[str]:
    """Return them as options of a command."""
    return [word for each in overrides for word in ("--set", each)]


@contextmanager
def traffic(near: Host, far: Host) -> Iterator[None]:
    """Send from one host to another while the context lasts."""
    is_over = threading.Event()

    def send() -> None:
        while not is_over.wait(PAUSE_S):
            sender.sendall(bytes(TRAFFIC_BYTES))
            receiver.recv(TRAFFIC_BYTES, socket.MSG_WAITALL)

    with ExitStack() as stack:
        with far.entered():
            listener = stack.enter_context(socket.create_server((far.address, 0)))
        with near.entered():
            sender = stack.enter_context(socket.create_connection(listener.getsockname()))
        receiver = stack.enter_context(listener.accept()[0])
        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join()


def run_live(network: Network, folder: Path) -> Live:
    """Measure the network, then run over it and measure it beside the run."""
    before, beside, run = (folder / name for name in ("before", "beside", "run"))
    with (
        traffic(network.plant, network.controller),
        network.relay(_RELAY, _PLANT) as begun_s,
        network.relay(_SERVER_RELAY, _SERVER) as probe_begun_s,
        network.plant.command("link", "--serve", "--zenoh", "--port", _SERVER) as serving,
    ):
        await_line(serving, "answering")
        with network.probe(before, "--duration", BEFORE_S) as link:
            await_line(link, _LAST_LINE)
        with network.probe(beside, "--duration", 600) as link:
            network.run(run)
            time.sleep(probe_begun_s - begun_s)  # its relay plays the end of the run so much later
            link.send_signal(signal.SIGINT)
            first_s = instant_s(await_line(link, "first message"))
            await_line(link, _LAST_LINE)
    data, _ = load_run(run)
    start_s = data.last_values(Role.PLANT, EventKind.ENDED)["start_s"]
    own = folder / "own"
    for way, (sent_s, delays_ms) in measured_link(data).items():
        whole = MeasuredDelays(np.append(0.0, sent_s), np.append(delays_ms[0], delays_ms))
        write_trace(whole, traced(own, way))
    into_s = (start_s - begun_s) - (first_s - probe_begun_s)
    traces = {"by the run": (own, 0.0), "beside": (beside, into_s), "before": (before, 0.0)}
    return Live(read_summary(run), traces)


def instant_s(line: str) -> float:
    """Return the time at the end of a line, on this machine's monotonic clock."""
    ago = dt.datetime.now(dt.UTC) - dt.datetime.fromisoformat(line.split()[-1])
    return time.monotonic() - ago.total_seconds()


def traced(prefix: Path, way: str) -> Path:
    """Return the file of a trace, as `link` names it."""
    return Path(f"{prefix}_{way}.csv")


def replay(prefix: Path, start_s: float) -> JudgedRun:
    """Simulate over a measured network."""
    # An uplink trace begins with the first answer.
    answered_s = read_trace(traced(prefix, "downlink")).delays_ns[0] * 1e-9
    starts_s = {"uplink": max(start_s - answered_s, 0.0), "downlink": start_s + _LEAD_S}
    words = [
        f"link.{way}.trace={{file: {traced(prefix, way)}, start_s: {begin_s}}}"
        for way, begin_s in starts_s.items()
    ]
    return execute(load_setup("paper_arm", [*SETTINGS, *words]), InProcess())


def rms_mrad(summary: Mapping[str, Any]) -> Vector:
    """RMS errors of the joints."""
    return 1e3 * np.array(summary["tracking"]["rms_rad"])


def row(network: Network, folder: Path) -> str:
    """Run once, and replay each measurement of the network."""
    live = run_live(network, folder)
    found = live.summary["transport"]["uplink"]["measured_ms"]
    cells = [
        str(network.seed),
        ", ".join(f"{found[name]:.2f}" for name in ("p50", "p99", "max")),
        live.summary["verdict"],
        ", ".join(f"{1e3 * each:.1f}" for each in rms_mrad(live.summary)),
    ]
    for prefix, start_s in live.traces.values():
        replayed = replay(prefix, start_s).summary
        apart = 100 * np.abs(rms_mrad(replayed) / rms_mrad(live.summary) - 1.0)
        cells.append(f"{replayed['verdict']}: {', '.join(f'{each:.1f}' for each in apart)} %")
    return f"| {' | '.join(cells)} |"


def main(first: int, last: int, scale: float = 1.0) -> None:
    """Print the table."""
    print(
        "| seed | uplink p50, p99, max, ms | live | RMS live per joint, µrad"
        " | replay of the run's own delays | of `link` beside | of `link` before |"
    )
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # it removes the hosts, too
    try:
        with two_hosts() as hosts:
            for seed in range(first, last + 1):
                with tempfile.TemporaryDirectory() as folder:
                    print(row(Network(*hosts, seed, scale), Path(folder)), flush=True)
    except OSError as error:
        sys.exit(f"skipped: {error}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), *map(float, sys.argv[3:4]))
