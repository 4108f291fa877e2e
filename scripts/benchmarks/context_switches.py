"""Context switches of an exchange, thread by thread, which no neighbour's load changes.

``python -m scripts.benchmarks.context_switches``. Linux only.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from scripts.benchmarks.echo import EchoPair, Transport
from scripts.benchmarks.transports import zenoh_callbacks
from scripts.benchmarks.transports.bare import RawUdp, Zenoh

_JOINTS = ("base_yaw", "shoulder", "elbow")
_EXCHANGES = 2000
_TRANSPORTS: dict[str, type[Transport]] = {
    "Zenoh": Zenoh,
    "callbacks": zenoh_callbacks.Near,
    "UDP": RawUdp,
}


def switches_per_exchange(
    transport: type[Transport], exchanges: int
) -> dict[str, dict[str, float]]:
    """Return the number of times that each thread gave its CPU up to wait.

    Args:
        transport: what carries the messages.
        exchanges: how many to count.

    Returns:
        by end (``near``, ``far``), waits per exchange by name of the thread.
    """
    with EchoPair(transport, _JOINTS, realtime=False) as pair:
        before = {end: _waits(pid) for end, pid in pair.pids.items()}
        pair.round_trips_us(exchanges)
        return {
            end: {name: n / exchanges for name, n in (_waits(pid) - before[end]).items()}
            for end, pid in pair.pids.items()
        }


def _waits(pid: int) -> Counter[str]:
    """Voluntary context switches of a process' threads so far, by name."""
    waits: Counter[str] = Counter()
    for task in Path(f"/proc/{pid}/task").iterdir():
        lines = (task / "status").read_text().splitlines()
        fields = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
        waits[fields["Name"]] += int(fields["voluntary_ctxt_switches"])
    return waits


def main() -> None:
    """Count, and print a line for each end."""
    for name, transport in _TRANSPORTS.items():
        for end, waits in switches_per_exchange(transport, _EXCHANGES).items():
            shown = ", ".join(f"{thread} {n:.2f}" for thread, n in waits.items() if n > 0.02)
            print(f"{name:16} {end:4} {sum(waits.values()):5.2f}: {shown}")


if __name__ == "__main__":
    main()
