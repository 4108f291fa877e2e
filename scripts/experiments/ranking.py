"""Which law is better, by how much, and whether that outlives other gains.

``python -m scripts.experiments.ranking paper_arm`` judges every law on the scenario itself and on
the harder one that laws are tuned on, then changes the gains of each law at random. With
``--gains FILE`` it takes gains as `scripts.experiments.tuning` prints them; laws that the file
leaves out keep the gains of the scenario.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.laws import COMPARED_LAWS
from deploy.run.execute import execute
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import override, read_yaml
from scripts.experiments.tuning import cost, tuning_setup, varied, with_gains

PROPOSED = "fixed_time_neural"
RIVALS = ("pid", "smc", "tsmc", "ftsmc")
EQUALLY_TUNED = Path(__file__).with_name("paper_arm_tuned_gains.yaml")
"""Gains that the one procedure found for every law on `paper_arm`."""

SPREAD = 0.3
DRAWN_S = 8.0
"""How long a run with drawn gains is."""


@dataclass(frozen=True)
class Evaluation:
    """What became of one run.

    Attributes:
        rms_mrad: RMS error per joint, shape (joints,).
        variation_nm_per_s: total variation of the torque per joint, shape (joints,).
        kept: whether it came to its end within its bounds.
        settling_bound_s: the bound that follows from its gains; None for a law that has none.
    """

    rms_mrad: Vector
    variation_nm_per_s: Vector
    kept: bool
    settling_bound_s: float | None


def evaluate(setup: Setup) -> Evaluation:
    """Run a scenario and judge it."""
    summary = execute(setup).summary
    tracking = summary["tracking"]
    return Evaluation(
        rms_mrad=1e3 * np.array(tracking["rms_rad"]),
        variation_nm_per_s=np.array(summary["torque"]["total_variation_nm_per_s"]),
        kept=summary["bounds"]["kept"],
        settling_bound_s=tracking["settling_bound_s"],
    )


def drawn(setup: Setup, seed: int) -> Setup:
    """The same scenario with every tuned gain of its law changed at random by up to `SPREAD`."""
    random = np.random.default_rng(seed)
    gains = varied(setup.gains, lambda count: random.uniform(1 - SPREAD, 1 + SPREAD, count))
    return with_gains(setup, gains)


def load_gains(path: Path | None) -> list[str]:
    """A file of gains as overrides of a scenario."""
    return gains_as_overrides({} if path is None else read_yaml(path))


def gains_as_overrides(gains: Mapping[str, Any]) -> list[str]:
    """Gains by law as overrides of a scenario."""
    return [override(f"controller.gains.{law}", values) for law, values in gains.items()]


def verdict_table(scenario: str, overrides: Sequence[str]) -> Iterator[str]:
    """A row per law: the scenario itself, then the one for tuning, with its cost."""
    yield (
        "| law | RMS, mrad | Σ\\|Δτ\\|, N m/s | bounds | settling bound, s "
        "| for tuning: RMS | Σ\\|Δτ\\| | bounds | cost |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for law in COMPARED_LAWS:
        clean = evaluate(load_setup(scenario, [*overrides, f"controller.law={law}"]))
        harder_setup = tuning_setup(scenario, law, overrides)
        harder = evaluate(harder_setup)
        bound = clean.settling_bound_s
        cells = [
            f"`{law}`",
            *_cells(clean),
            "–" if bound is None else f"{bound:.2f}",
            *_cells(harder),
            f"{cost(harder_setup):.2f}",
        ]
        yield f"| {' | '.join(cells)} |"


def draws_table(scenario: str, overrides: Sequence[str], draws: int) -> Iterator[str]:
    """A row per law, whose gains are changed at random while the others keep theirs.

    A rival is compared with the proposed law, the proposed law with the best rival on each joint.
    """
    fixed = [*overrides, f"duration_s={DRAWN_S}"]
    laws = (PROPOSED, *RIVALS)
    setups = {law: load_setup(scenario, [*fixed, f"controller.law={law}"]) for law in laws}
    as_is = {law: evaluate(setup).rms_mrad for law, setup in setups.items()}
    best_rival = np.min([as_is[rival] for rival in RIVALS], axis=0)
    yield (
        "| gains changed | neural law better on all joints | on none "
        "| a rival's RMS over the neural law's | bounds kept | Σ\\|Δτ\\|, N m/s |"
    )
    yield "|---|---|---|---|---|---|"
    for law, setup in setups.items():
        runs = [evaluate(drawn(setup, seed)) for seed in range(draws)]
        rms = np.array([run.rms_mrad for run in runs])
        ratios = best_rival / rms if law == PROPOSED else rms / as_is[PROPOSED]
        cells = [
            f"`{law}`",
            f"{(ratios > 1.0).all(axis=1).sum()} of {draws}",
            f"{(ratios <= 1.0).all(axis=1).sum()} of {draws}",
            _ranges(ratios, ".2f"),
            f"{sum(run.kept for run in runs)} of {draws}",
            _ranges(np.array([run.variation_nm_per_s for run in runs]), ".0f"),
        ]
        yield f"| {' | '.join(cells)} |"


def _ranges(values: Matrix, digits: str) -> str:
    """From the smallest to the largest of each column."""
    ends = zip(values.min(axis=0), values.max(axis=0), strict=True)
    return ", ".join(f"{low:{digits}}–{high:{digits}}" for low, high in ends)


def _cells(run: Evaluation) -> tuple[str, str, str]:
    return (
        ", ".join(f"{value:.3f}" for value in run.rms_mrad),
        ", ".join(f"{value:.0f}" for value in run.variation_nm_per_s),
        "kept" if run.kept else "lost",
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Rank the laws, also with other gains.")
    parser.add_argument("scenario")
    parser.add_argument("--gains", type=Path)
    parser.add_argument("--draws", type=int, default=20)
    options = parser.parse_args()
    overrides = load_gains(options.gains)
    for row in verdict_table(options.scenario, overrides):
        print(row, flush=True)
    print()
    for row in draws_table(options.scenario, overrides, options.draws):
        print(row, flush=True)


if __name__ == "__main__":
    main()
