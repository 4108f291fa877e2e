"""How often true parameters lie within their 95 % intervals, on logs of virtual robots.

    python -m scripts.experiments.identify_coverage [--arm NAME] [--draws N] [--seed N]
        [--seconds S] [--correlation S]

Each draw is a robot near a shipped arm's file, with other masses, friction, rotors and lag. It
follows the trajectory of `identify --design`; its log has 125 Hz and noise, whose torques may be
correlated in time. The table has, for each parameter, in how many draws it was reported as seen,
and how many of these held the truth. The last lines count only parameters that a fifth of the draws
show, and all seen and unseen ones together.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from deploy.identify.base_parameters import Interval, base_values
from deploy.identify.identification import Identified, Wishes, identify
from deploy.identify.regression import COULOMB, ROTOR, VISCOUS
from tests.deploy.identify.virtual_logs import Truth, excitation, truth_of, write_log

_TERMS = (("coulomb", COULOMB), ("viscous", VISCOUS), ("rotors", ROTOR))
_SHOWN = 0.2


def values(found: Identified, truth: Truth) -> Iterator[tuple[str, Interval, float]]:
    """Yield name, identified and true value of each parameter."""
    true = found.group.matrix @ truth.bodies
    bases = base_values(found.fit, found.group)
    yield from zip(found.group.names, bases, map(float, true), strict=True)
    for name, term in _TERMS:
        for joint, each in enumerate(getattr(truth, name)):
            whole = f"{found.robot.joint_names[joint]}: {name}"
            yield whole, found.term(joint, term), float(each)
    delay_s, sd_s = found.fit.delay_s
    yield "delay", Interval(delay_s, 1.96 * sd_s, 0.0, seen=True), truth.lag_s


def main() -> None:
    """Draw robots, identify each, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arm", default="paper_arm")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first draw")
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--correlation", type=float, default=0.0, help="of the noise, in s")
    given = parser.parse_args()
    robot, model, *_ = excitation(given.arm, given.seconds)
    off = defaultdict[str, list[float]](list)
    spent_s = list[float]()
    with TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        for seed in range(given.seed, given.seed + given.draws):
            random = np.random.default_rng(seed)
            truth = truth_of(robot, model, random)
            write_log(log, given.arm, truth, random, given.seconds, correlation_s=given.correlation)
            start_s = time.process_time()
            found = identify([log], [], None, robot, Wishes())
            spent_s.append(time.process_time() - start_s)
            for name, value, true in values(found, truth):
                if value.seen:
                    off[name].append(abs(value.value - true) / value.half)
    inside = {name: np.array(each) <= 1.0 for name, each in off.items()}
    for name, each in inside.items():
        print(
            f"{name:40} seen {len(each):4d} of {given.draws}, inside {100 * each.mean():5.1f} %,"
            f" 95 % are within {np.quantile(off[name], 0.95):.2f} of the interval"
        )
    shares = [each.mean() for each in inside.values() if len(each) >= _SHOWN * given.draws]
    total = np.concatenate(list(inside.values())).mean()
    print(f"{len(shares)} parameters: {100 * min(shares):.1f} to {100 * max(shares):.1f} % inside")
    print(f"all together {100 * total:.1f} %; median CPU time {np.median(spent_s):.2f} s")


if __name__ == "__main__":
    main()
