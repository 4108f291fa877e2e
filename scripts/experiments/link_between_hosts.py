"""Measurements of `funnel-hil link` between two network namespaces, beside the injected delays.

``python -m scripts.experiments.link_between_hosts`` prints a table. Root is needed.
"""

from __future__ import annotations

import signal
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Vector
from deploy.judge.findings.link_delays import share_interval
from plant_emulator.channel.trace_file import read_trace
from scripts.experiments.two_hosts import Host, await_line, two_hosts

_SERVED, _RELAYED = 7460, 7461
_PROTOCOLS, _DELAYS_MS, _LOSSES = ("udp", "tcp", "zenoh"), (5.0, 20.0, 50.0), (0.01, 0.05)
_CASES = [
    *((protocol, delay_ms, 0.0) for protocol in _PROTOCOLS for delay_ms in _DELAYS_MS),
    *(("udp", _DELAYS_MS[0], loss) for loss in _LOSSES),
]
_DURATION_S = 6.0


class Found(NamedTuple):
    """Measurements of one direction.

    Attributes:
        delays_ms: of messages that arrived.
        lost: number of the others.
    """

    delays_ms: Vector
    lost: int

    @property
    def loss_interval(self) -> tuple[float, float]:
        return share_interval(self.lost, self.lost + len(self.delays_ms))


def measure(
    hosts: tuple[Host, Host], protocol: str, delay_ms: float, loss: float, duration_s: float
) -> dict[str, Found]:
    """Measure a link through a relay, by direction.

    Args:
        hosts: server, and client with the relay.
        protocol: ``udp``, ``tcp`` or ``zenoh``.
        delay_ms: what the relay does in each direction.
        loss: share that it loses in each direction.
        duration_s: how long.
    """
    server, client = hosts
    served_by = ["--zenoh"] if protocol == "zenoh" else []
    relayed_by, measured_by = ["--udp"], list[str]()
    if protocol != "udp":
        relayed_by, measured_by = [], [f"--{protocol}"]
    relayed = f"{client.address}:{_RELAYED}", f"{server.address}:{_SERVED}"
    settings = [f"link.{way}.loss={loss}" for way in ("uplink", "downlink")]
    words = [word for each in settings for word in ("--set", each)]
    with (
        tempfile.TemporaryDirectory() as folder,
        server.command("link", "--serve", "--port", _SERVED, *served_by) as serving,
        client.command("relay", *relayed, "--delay", delay_ms, *words, *relayed_by) as relay,
    ):
        await_line(serving, "answering")
        await_line(relay, "relaying")
        out = Path(folder, "found")
        options = ("--port", _RELAYED, "--duration", duration_s, "--out", out)
        with client.command("link", client.address, *measured_by, *options) as link:
            await_line(link, "uplink: {trace")  # its last line
        traces = {way: read_trace(Path(f"{out}_{way}.csv")) for way in ("downlink", "uplink")}
    return {
        way: Found(each.delays_ns[each.delays_ns >= 0] / 1e6, int((each.delays_ns < 0).sum()))
        for way, each in traces.items()
    }


def main() -> None:
    """Print the table."""
    print("| protocol | direction | injected | measured p50, p99, ms | lost, 95 % interval |")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # it removes the hosts, too
    try:
        with two_hosts() as hosts:
            for protocol, delay_ms, loss in _CASES:
                for way, found in measure(hosts, protocol, delay_ms, loss, _DURATION_S).items():
                    middle, high = np.percentile(found.delays_ms, [50, 99])
                    least, most = found.loss_interval
                    print(
                        f"| {protocol} | {way} | {delay_ms:g} ms, {100 * loss:g} %"
                        f" | {middle:.3f}, {high:.3f}"
                        f" | {found.lost}, {100 * least:.2f} to {100 * most:.2f} % |",
                        flush=True,
                    )
    except OSError as error:
        sys.exit(f"skipped: {error}")


if __name__ == "__main__":
    main()
