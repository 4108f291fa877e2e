"""Coverage of the 95 % intervals of identified parameters, on logs of virtual robots.

    python -m scripts.experiments.identify_coverage [--arm NAME ...] [--correlation S ...]
        [--draws N] [--seed N] [--seconds S] [--noise SHARE] [--each]

Each draw is a robot near a shipped arm's file, with other masses, friction, rotors and lag. It
follows the trajectory of `identify --design`; its log has 125 Hz and noise, whose torques are
correlated over the given times. The table has a row for each arm and correlation: how many
parameters of all draws were reported as seen, and how many of these held the truth; then the same
of all parameters, masses of links included. `--each` adds a row for each parameter.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from deploy.measure.identify.identification import Wishes, identify
from tests.deploy.measure.identify.virtual_logs import excitation, intervals, truth_of, write_log


class Off(NamedTuple):
    """A value's distance from the truth over half of its interval, and what is known of it."""

    off: float
    half: float
    seen: bool


def drawn(given: argparse.Namespace, arm: str, correlation_s: float) -> dict[str, list[Off]]:
    """Identify virtual robots; return what each parameter was like in each draw."""
    robot, model, *_ = excitation(arm, given.seconds)
    found = defaultdict[str, list[Off]](list)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        for seed in range(given.seed, given.seed + given.draws):
            random = np.random.default_rng(seed)
            truth = truth_of(robot, model, random)
            write_log(log, arm, truth, random, given.seconds, given.noise, correlation_s)
            for name, value, true in intervals(identify([log], [], None, robot, Wishes()), truth):
                if value.half > 0.0:
                    off = abs(value.value - true) / value.half
                    found[name].append(Off(off, value.half, value.seen))
    return found


def main() -> None:
    """Draw robots, identify each, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arm", nargs="+", default=["paper_arm"])
    parser.add_argument("--correlation", nargs="+", type=float, default=[0.0], help="s")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first draw")
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--noise", type=float, default=0.01, help="over the largest torque")
    parser.add_argument("--each", action="store_true")
    given = parser.parse_args()
    for arm in given.arm:
        for correlation_s in given.correlation:
            start_s = time.process_time()
            found = drawn(given, arm, correlation_s)
            spent_s = (time.process_time() - start_s) / given.draws
            every = [each for values in found.values() for each in values]
            print(f"{arm:12} {correlation_s:5g} s: {_shares(every)}; {spent_s:.1f} s CPU a draw")
            if given.each:
                for name, values in found.items():
                    print(f"    {name:40} {_shares(values)}")


def _shares(values: list[Off]) -> str:
    inside = np.array([each.off <= 1.0 for each in values])
    seen = np.array([each.seen for each in values])
    of_seen = f"{100 * inside[seen].mean():5.1f} %" if seen.any() else "    – "
    half = np.median([each.half for each in values])
    return (
        f"{of_seen} of {seen.sum():5d} seen, {100 * inside.mean():5.1f} % of {len(seen):5d} inside,"
        f" median half-width {half:.3g}"
    )


if __name__ == "__main__":
    main()
