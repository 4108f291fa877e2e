"""What error each law reaches with a torque that may travel only so far: laws at equal smoothness.

Switching buys precision with torque that goes back and forth. So a ranking by error alone says
little, and one by error and smoothness together says as much as the weight between them. Here every
law is tuned for the least error at the same limit on the travel of its torques, for several limits.

The rules, written down before the first search and the same for all laws, are those of `tuning`
but for these:

- **limit**: no torque may travel further than `TRAVEL_LIMITS_PER_S` times its own largest value per
  second. The proposed law as shipped travels 1.6 to 6, the rivals that switch 33 to 76. (The last
  limit, none at all, was added when the others had been seen);
- **cost**: the logarithm of the error, averaged over joints; travel beyond the limit weighs ten
  times as much, and less travel than that is worth nothing;
- **what is tuned**: the boundary layer of the laws that switch as well. It begins at
  `BOUNDARY_LAYER_RAD_S`, which makes the switching term a gain of 20 to 100 per second near zero.
  Without a limit there is none;
- **budget**: `BUDGET_S` simulated seconds for each law and limit, 100 whole trials.

``python -m scripts.experiments.equal_travel paper_arm --out travel.yaml`` does all searches, on all
cores, keeps the gains found, and prints tables (needs the extra ``tuning``; an hour on two cores).
With a file that exists, only the tables are made, which takes some five minutes.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.progress import track

from controller.laws import COMPARED_LAWS as LAWS
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import plain, read_yaml
from scripts.experiments.ranking import (
    PROPOSED,
    RIVALS,
    Evaluation,
    draws_table,
    evaluate,
    gains_as_overrides,
)
from scripts.experiments.tuning import tune, tuning_setup, with_gains

TRAVEL_LIMITS_PER_S = (2.0, 6.0, 20.0, 60.0, math.inf)
AS_SHIPPED_PER_S = 6.0
"""The limit that the proposed law as shipped keeps, but for 0.7 % on the shoulder."""

AT_EQUAL_TRAVEL = Path(__file__).with_name("paper_arm_equal_travel.yaml")
"""Gains that the searches found on `paper_arm`."""

DRAWS = 20
BOUNDARY_LAYER_RAD_S = 0.1
BUDGET_S = 800.0

Found = dict[str, dict[str, dict[str, Any]]]
"""Gains as plain values, by limit and law."""


def search(scenario: str, limit_per_s: float, law: str) -> dict[str, Any]:
    """The gains of a law with the least error under a limit."""
    setup = tuning_setup(scenario, law)
    if hasattr(setup.gains, "boundary_layer") and math.isfinite(limit_per_s):
        smoothed = setup.gains._replace(boundary_layer=BOUNDARY_LAYER_RAD_S)
        setup = with_gains(setup, smoothed)
    gains, _ = tune(setup, BUDGET_S, travel_limit_per_s=limit_per_s)
    return {name: _short(value) for name, value in plain(gains).items()}


def _short(value: Any) -> Any:
    """Four digits, which say all that a search knows."""
    return [_short(one) for one in value] if isinstance(value, list) else float(f"{value:.4g}")


def search_all(scenario: str) -> Found:
    """Search for every law under every limit, on all cores."""
    jobs = [(limit, law) for limit in TRAVEL_LIMITS_PER_S for law in LAWS]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        started = {pool.submit(search, scenario, *job): job for job in jobs}
        done = track(as_completed(started), "searching", total=len(jobs))
        gains = {started[future]: future.result() for future in done}
    return {f"{limit:g}": {law: gains[limit, law] for law in LAWS} for limit in TRAVEL_LIMITS_PER_S}


def table(found: Found, setup_of: Callable[[str, Sequence[str]], Setup]) -> Iterator[str]:
    """A row per law, a column per limit: RMS error per joint, mrad, and where bounds were lost.

    Args:
        found: the gains.
        setup_of: what to judge on, from a law and overrides.
    """
    yield "| law | " + " | ".join(f"{limit} /s" for limit in found) + " |"
    yield "|---" * (len(found) + 1) + "|"
    judged = {
        law: [evaluate(setup_of(law, gains_as_overrides(gains))) for gains in found.values()]
        for law in LAWS
    }
    for law, runs in judged.items():
        yield f"| `{law}` | " + " | ".join(map(_cell, runs)) + " |"
    rivals = np.min([[run.rms_mrad for run in judged[rival]] for rival in RIVALS], axis=0)
    ratios = rivals / [run.rms_mrad for run in judged[PROPOSED]]
    cells = (", ".join(f"{ratio:.2g}" for ratio in of_joints) for of_joints in ratios)
    yield "| best rival / neural law | " + " | ".join(cells) + " |"


def _cell(run: Evaluation) -> str:
    return ", ".join(f"{rms:.3g}" for rms in run.rms_mrad) + ("" if run.kept else " **lost**")


def main() -> None:
    """Search where there is no file yet, and print the tables."""
    parser = argparse.ArgumentParser(description="Laws at equal travel of their torques.")
    parser.add_argument("scenario")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    if not options.out.exists():
        found = search_all(options.scenario)
        options.out.write_text(
            yaml.safe_dump(found, sort_keys=False, default_flow_style=None), encoding="utf-8"
        )
    found = read_yaml(options.out)
    print("As tuned on, 8 s:\n")
    print("\n".join(table(found, partial(tuning_setup, options.scenario))))
    print("\nThe scenario itself:\n")
    print("\n".join(table(found, partial(_scenario_setup, options.scenario))))
    print("\nRivals so tuned, the neural law as shipped, gains changed at random:\n")
    print("\n".join(draws_table(options.scenario, rivals_as_smooth(found), DRAWS)))


def rivals_as_smooth(found: Found) -> list[str]:
    """Overrides that give the rivals what they have under the limit of the law as shipped."""
    gains = found[f"{AS_SHIPPED_PER_S:g}"]
    return gains_as_overrides({rival: gains[rival] for rival in RIVALS})


def _scenario_setup(scenario: str, law: str, overrides: Sequence[str]) -> Setup:
    return load_setup(scenario, [*overrides, f"controller.law={law}"])


if __name__ == "__main__":
    main()
