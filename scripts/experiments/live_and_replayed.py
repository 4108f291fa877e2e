"""A loop over a real link, and the trace that the run measured of this link replayed beside it.

``python -m scripts.experiments.live_and_replayed FIRST LAST [SCALE]`` runs an arm in real time over
Zenoh (TCP) and a relay, which is a process of its own and plays a bursty trace, while other traffic
crosses the same interface. It then simulates the arm with the one-way delays that this run measured
of its link, and prints a row for each seed.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.link.configuration import LinkConfiguration
from deploy.judge.link_delays import Measured, measured_link
from deploy.measure.trace_output import write_trace
from deploy.run.execute import InProcess, InProcesses, JudgedRun, execute
from deploy.run.network.links import with_free_endpoints
from deploy.run.network.real_delay import RealDelay, RelayOptions, real_delay
from deploy.run.run_folder import RunFolder
from deploy.scenario.scenario import load_setup

SETTINGS = [
    "duration_s=8", "controller.delay_compensation.enabled=true", "link.deadline_ms=100",
    "controller.delay_compensation.expected_round_trip_ms=12", "plant.command_timeout_ms=1000",
]  # fmt: skip
DOWNLINK, TRACE = {"delay_ms": 4}, "deploy/traces/5g.parquet"
SCALE = float(sys.argv[3]) if len(sys.argv) > 3 else 1.0
TRAFFIC_BYTES, PAUSE_S = 20_000, 0.01
_LEAD_S = 0.0003
"""A replayed command is sent without the step of the controller, which takes less than this."""


class TracedDelay(RealDelay):
    """A relay that plays the link of this experiment."""

    @property
    def options(self) -> RelayOptions:
        uplink = {"trace": {"file": TRACE, "scale": SCALE}}
        link = LinkConfiguration.model_validate({"downlink": DOWNLINK, "uplink": uplink})
        return super().options._replace(link=link, seed=round(self.round_trip_ms))


def send_traffic(is_over: threading.Event) -> None:
    """Send to a socket of this machine until the end."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        far = socket.create_connection(listener.getsockname())
        near, _ = listener.accept()
        with far, near:
            while not is_over.wait(PAUSE_S):
                far.sendall(bytes(TRAFFIC_BYTES))
                near.recv(TRAFFIC_BYTES, socket.MSG_WAITALL)


def run_live(number: int, folder: Path) -> JudgedRun:
    """Run in real time over the relay; `number` is its seed."""
    setup = with_free_endpoints(load_setup("paper_arm", [*SETTINGS, "clock=realtime"]))
    delay = TracedDelay(*real_delay(setup, float(number)))
    run = execute(
        setup, InProcesses(delay), files := RunFolder.begin(setup, folder, overwrite=True)
    )
    run.keep(files)
    return run


def replay(measured: dict[str, Measured], folder: Path) -> JudgedRun:
    """Simulate with the measured delays, from the start of the run on."""
    words = []
    for way, (sent_s, delays_ms) in measured.items():
        file, start_s = folder / f"{way}.parquet", _LEAD_S if way == "downlink" else 0.0
        times_s, delays = np.append(0.0, sent_s), np.append(delays_ms[0], delays_ms)
        write_trace(Measured(times_s, delays), file)
        words += [f"link.{way}.trace={{file: {file}, start_s: {start_s}}}"]
    return execute(load_setup("paper_arm", [*SETTINGS, *words]), InProcess())


def rms_mrad(run: JudgedRun) -> Matrix:
    """RMS errors of the joints."""
    return 1e3 * np.array(run.summary["tracking"]["rms_rad"])


def main(first: int, last: int) -> None:
    """Print the table."""
    print("| run | live | replayed | uplink p50, p99, max, ms | RMS live, µrad | apart |")
    for number in range(first, last + 1):
        is_over = threading.Event()
        traffic = threading.Thread(target=send_traffic, args=(is_over,), daemon=True)
        traffic.start()
        with tempfile.TemporaryDirectory() as folder:
            live = run_live(number, Path(folder) / "live")
            is_over.set()
            traffic.join()
            replayed = replay(measured_link(live.data), Path(folder))
            found = live.summary["transport"]["uplink"]["measured_ms"]
            delays = ", ".join(f"{found[name]:.2f}" for name in ("p50", "p99", "max"))
            apart = np.abs(rms_mrad(replayed) / rms_mrad(live) - 1.0)
            print(
                f"| {number} | {live.summary['verdict']} | {replayed.summary['verdict']} | {delays}"
                f" | {', '.join(f'{1e3 * each:.1f}' for each in rms_mrad(live))}"
                f" | {', '.join(f'{100 * each:.1f} %' for each in apart)} |",
                flush=True,
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
