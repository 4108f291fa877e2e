"""What an exchange costs in context switches, thread by thread, which no neighbour's load changes.

``python -m deploy.benchmarks.context_switches [TRANSPORT…]``, of `deploy.benchmarks.transports`.
Linux only.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from deploy.benchmarks.echo import EchoPair

_JOINTS = ("base_yaw", "shoulder", "elbow")
_EXCHANGES = 2000
_TRANSPORTS = ("zenoh", "zenoh_callbacks", "udp")


def switches_per_exchange(transport: str, exchanges: int) -> dict[str, dict[str, float]]:
    """How often each thread gave its CPU up to wait.

    Args:
        transport: name of a module in `deploy.benchmarks.transports`.
        exchanges: how many to count.

    Returns:
        by end (``near``, ``far``), waits per exchange by name of the thread.
    """
    with EchoPair(transport, _JOINTS, realtime=False) as pair:
        ends = {"near": pair.near_pid, "far": _only_child(pair.near_pid)}
        before = {end: _waits(pid) for end, pid in ends.items()}
        pair.round_trips_us(exchanges)
        return {
            end: {name: n / exchanges for name, n in (_waits(pid) - before[end]).items()}
            for end, pid in ends.items()
        }


def _only_child(pid: int) -> int:
    children = [
        child
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    (child,) = children
    return int(child)


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
    for transport in sys.argv[1:] or _TRANSPORTS:
        for end, waits in switches_per_exchange(transport, _EXCHANGES).items():
            shown = ", ".join(f"{name} {n:.2f}" for name, n in waits.items() if n > 0.02)
            print(f"{transport:16} {end:4} {sum(waits.values()):5.2f}: {shown}")


if __name__ == "__main__":
    main()
