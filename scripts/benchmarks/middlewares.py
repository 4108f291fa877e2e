"""The loop in real time and in lockstep beside bare transports that carry the same bytes.

`python -m scripts.benchmarks.middlewares [--quick]`; pip install -e '.[bench]' brings them.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from importlib.util import find_spec

from rich.console import Console

from deploy.studies.bench.command import show_section
from scripts.benchmarks.round_trip import (
    SECURED_ZENOH,
    TRANSPORTS,
    measure_lockstep,
    measure_round_trips,
)

_HERE = "scripts.benchmarks.transports"
CALLBACKS = "Zenoh with callbacks"
OTHERS = {
    CALLBACKS: (f"{_HERE}.zenoh_callbacks", "zenoh"),
    "pyzmq": (f"{_HERE}.pyzmq", "zmq"),
    "LCM": (f"{_HERE}.lcm_udp", "lcm"),
    "CycloneDDS": (f"{_HERE}.cyclone", "cyclonedds"),
}
"""By name: a module whose `Near` is the transport, and the library it needs."""


def main() -> None:
    """Measure, and show a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    console, transports = Console(), dict(TRANSPORTS)
    for name, (module, library) in OTHERS.items():
        if find_spec(library) is None:
            console.print(f"{name} is not installed: pip install -e '.[bench]'", markup=False)
        else:
            transports[name] = import_module(module).Near
    seconds, repetitions = (0.5, 2) if quick else (1.5, 4)
    variants = (SECURED_ZENOH, CALLBACKS)
    show_section(
        console, measure_round_trips("paper_arm", seconds, repetitions, transports, variants)
    )
    show_section(console, measure_lockstep("paper_arm", seconds, repetitions))


if __name__ == "__main__":
    main()
