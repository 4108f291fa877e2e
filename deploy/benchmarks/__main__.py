"""`python -m deploy.benchmarks [SCENARIO]`: the ratios as a table, and as JSON with `--json`."""

from __future__ import annotations

import argparse
import json

from rich.console import Console
from rich.table import Table

from deploy.benchmarks.loop_costs import LoopCosts, measure_loop_costs


def show(costs: LoopCosts, console: Console) -> None:
    """Print costs and ratios."""
    table = Table(title="per tick, µs")
    table.add_column("what")
    for heading in ("median", "lowest", "highest"):
        table.add_column(heading, justify="right")
    for name, cost in costs.measurements.items():
        values = (cost.median_us, cost.lowest_us, cost.highest_us)
        table.add_row(name, *(f"{value:.0f}" for value in values))
    console.print(table)
    console.print(f"simulate / bare pybullet calls: {costs.simulate_to_physics:.2f}")
    console.print(f"lockstep / (ping-pong + simulate): {costs.lockstep_to_parts:.2f}")


def main() -> None:
    """Measure and show."""
    parser = argparse.ArgumentParser(prog="python -m deploy.benchmarks", description=__doc__)
    parser.add_argument("scenario", nargs="?", default="paper_arm")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    costs = measure_loop_costs(arguments.scenario)
    if arguments.json:
        print(json.dumps(costs.as_dict(), indent=2))
    else:
        show(costs, Console())


if __name__ == "__main__":
    main()
