"""One procedure that tunes every law, the proposed one included, and what a trial of it is worth.

The rules, written down before the search was run and the same for all laws:

- **start**: the gains that the scenario gives, or else those that the law derives from the arm;
- **what is tuned**: all gains but powers, the regularisation width η and the boundary layer
  (`FIXED`), per joint where they are per joint; each law keeps the structure of its equations;
- **scenario**: the given one over 8 s, made as hard as a real arm by encoders of 20 bits, the noise
  of a velocity that an observer of 100 Hz derives from them, and one control period of transport
  delay. On a perfect arm every law gains precision from ever higher gains; a real one ends that;
- **cost** (`cost`): error first, smoothness second, both as logarithms and averaged over joints. To
  leave the funnel costs as much as an error e times as large, and more with time. A torque that
  reaches its limit is a failure;
- **search**: CMA-ES on the logarithms of the gains, from one seed;
- **budget**: 480 simulated seconds, which are 60 whole trials. The first half second, in which
  torques are largest, is tried alone: gains that saturate there cost no more than that.

``python -m scripts.experiments.tuning paper_arm smc`` prints the gains found (needs the extra
``tuning``). With a limit on the torque's travel error alone is the cost, and the boundary layer is
tuned too (`equal_travel`).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from deploy.run.execute import execute
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import plain, to_yaml

BUDGET_S = 480.0
DURATION_S = 8.0
START_S = 0.5
FIXED = frozenset(
    {"phi_1", "phi_2", "gamma_1", "gamma_2", "phi", "psi", "power", "eta", "boundary_layer"}
    | {"delayed_node_width", "delayed_adaptation", "delayed_k_2", "half_way_s"}
)
"""Gains that are not tuned, nor are those for delays that are compensated; where travel is limited,
those without `boundary_layer`."""

SMOOTHED = FIXED - {"boundary_layer"}
HARDWARE = (
    f"plant.encoder.resolution_rad={2.0 * math.pi / 2**20}",
    "plant.encoder.velocity_noise_rad_s=6e-4",
    "link.uplink.delay_ms=0.5",
    "link.downlink.delay_ms=0.5",
)
"""A real arm. Rounding to q = 2π/2²⁰ rad is a white noise of q/√12; an observer of bandwidth
ω = 2π 100 rad/s makes of it a velocity noise of about q/√12 √(ω³ T/2) = 6e-4 rad/s at T = 1 ms."""

SMOOTHNESS_WEIGHT = 0.25
"""Weight of the torque's total variation against that of the error, both as logarithms."""

EXCESS_WEIGHT = 10.0
"""Weight of travel beyond its limit against that of the error, both as logarithms."""

UNFINISHED, SATURATED = 1000.0, 100.0
"""Costs beyond any of a run that counts."""

_SPREAD = 0.3
_WIDEST = math.log(1000.0)


def with_gains(setup: Setup, gains: Any) -> Setup:
    """The same scenario under the same law with other gains."""
    return replace(setup, gains=gains)


def varied(gains: Any, factor: Callable[[int], Any], fixed: Collection[str] = FIXED) -> Any:
    """Gains with each tuned entry multiplied by a factor.

    Args:
        gains: a NamedTuple of gains.
        factor: called with the number of entries of a gain, returns factors of shape (entries,).
        fixed: names of gains that are not tuned.
    """
    values = {}
    for name, value in gains._asdict().items():
        if name not in fixed:
            product = value * factor(np.size(value))
            values[name] = product if isinstance(value, np.ndarray) else float(product[0])
    return gains._replace(**values)


def entries(gains: Any, fixed: Collection[str] = FIXED) -> int:
    """How many numbers of these gains are tuned."""
    return sum(np.size(value) for name, value in gains._asdict().items() if name not in fixed)


def scaled(gains: Any, log_factors: Vector, fixed: Collection[str] = FIXED) -> Any:
    """Gains with tuned entry number i multiplied by exp(log_factors[i]).

    Args:
        gains: a NamedTuple of gains.
        log_factors: shape (`entries(gains, fixed)`,).
        fixed: names of gains that are not tuned.
    """
    left = iter(np.exp(log_factors))
    return varied(gains, lambda count: np.array([next(left) for _ in range(count)]), fixed)


def cost(setup: Setup, travel_limit_per_s: float | None = None) -> float:
    """What a run of a scenario is worth; less is better.

    Args:
        setup: the scenario.
        travel_limit_per_s: how far any torque may travel, in its own limits per second; smoothness
            below it is worth nothing. None: every bit of smoothness is.
    """
    summary = execute(setup).summary
    torque, bounds = summary["torque"], summary["bounds"]
    if not summary["completed"]:
        return UNFINISHED
    if torque["saturated_fraction"] > 0.0:
        return float(SATURATED * (1.0 + torque["saturated_fraction"]))
    errors = np.array(summary["tracking"]["rms_rad"]) / setup.funnel.final_rad
    travel = np.array(torque["total_variation_nm_per_s"]) / setup.robot.effort_limits_nm
    is_outside = bounds["violation_fraction"] > 0.0
    outside = 1.0 + 10.0 * bounds["violation_fraction"] if is_outside else 0.0
    if travel_limit_per_s is None:
        roughness = SMOOTHNESS_WEIGHT * np.log(travel).mean()
    else:
        excess = np.maximum(np.log(travel / travel_limit_per_s), 0.0)
        roughness = excess.any() + EXCESS_WEIGHT * excess.mean()
    return float(np.log(errors).mean() + roughness + outside)


def trial(setup: Setup, travel_limit_per_s: float | None = None) -> tuple[float, float]:
    """Cost of a scenario, and the simulated time that it took to know, s."""
    scenario = setup.scenario
    metrics = scenario.metrics.model_copy(update={"from_s": 0.0})
    start = scenario.model_copy(update={"duration_s": START_S, "metrics": metrics})
    if (cost_of_start := cost(replace(setup, scenario=start))) >= SATURATED:
        return cost_of_start, START_S
    return cost(setup, travel_limit_per_s), START_S + scenario.duration_s


def tuning_setup(scenario: str, law: str, overrides: Sequence[str] = ()) -> Setup:
    """A scenario under a law, as it is tuned on, with overrides of its own such as gains."""
    tuned_on = [f"controller.law={law}", f"duration_s={DURATION_S}", *HARDWARE]
    return load_setup(scenario, [*overrides, *tuned_on])


def tune(
    setup: Setup,
    budget_s: float = BUDGET_S,
    seed: int = 1,
    travel_limit_per_s: float | None = None,
) -> tuple[Any, float]:
    """The best gains found, and their cost.

    Args:
        setup: the scenario under the law to be tuned, with the gains to start from.
        budget_s: simulated time to spend; the last trial may exceed it.
        seed: of the search.
        travel_limit_per_s: as of `cost`.
    """
    import cma  # of the extra `tuning`, which nothing else needs

    options = {"seed": seed, "bounds": [-_WIDEST, _WIDEST], "verbose": -9, "verb_log": 0}
    fixed = FIXED if travel_limit_per_s is None else SMOOTHED
    search = cma.CMAEvolutionStrategy(np.zeros(entries(setup.gains, fixed)), _SPREAD, options)
    best, best_cost, spent_s = setup.gains, math.inf, 0.0
    while True:
        population, costs = search.ask(), []
        for log_factors in population:
            gains = scaled(setup.gains, log_factors, fixed)
            reached, took_s = trial(with_gains(setup, gains), travel_limit_per_s)
            costs.append(reached)
            if reached < best_cost:
                best, best_cost = gains, reached
            spent_s += took_s
            if spent_s >= budget_s:
                return best, best_cost
        search.tell(population, costs)


def main() -> None:
    """Tune, and print the gains as YAML."""
    parser = argparse.ArgumentParser(description="Tune a law on a scenario.")
    parser.add_argument("scenario")
    parser.add_argument("law")
    parser.add_argument("--budget-s", type=float, default=BUDGET_S)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    setup = tuning_setup(options.scenario, options.law)
    gains, reached = tune(setup, options.budget_s, options.seed)
    print(f"# cost {reached:.3f} after {options.budget_s:g} simulated seconds")
    print(to_yaml({options.law: plain(gains)}))


if __name__ == "__main__":
    main()
