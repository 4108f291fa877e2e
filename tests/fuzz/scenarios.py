"""Mutated scenario files: each ends in a run, or in the one error that is exit code 2."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import yaml
from mutation import Mutator

from deploy.processes.links import check_link
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.yaml_files import ScenarioError

_TICKS = 3


def try_scenario(mutator: Mutator, folder: Path) -> str:
    """Mutate a shipped scenario, by its text or by its values; ``ran`` or ``refused``."""
    source = mutator.choose(sorted(SHIPPED.glob("*.yaml"))).read_text()
    if mutator.chance(0.3):
        text = mutator.text(source)
    else:
        text = yaml.safe_dump(mutator.values(yaml.safe_load(source)))
    file = folder / "mutated.yaml"
    file.write_text(text)
    try:
        setup = load_setup(str(file))
        check_link(setup, one_process=True)
    except ScenarioError as error:
        assert str(file) in str(error), str(error)
        return "refused"
    period_s = setup.grid.period_ns * 1e-9
    simulate(load_setup(str(file), [f"duration_s={_TICKS * period_s}", "plant.gui=false"]))
    return "ran"


def try_scenarios(count: int, seed: int, folder: Path) -> Counter[str]:
    """Outcomes of so many mutations."""
    mutator = Mutator(seed)
    return Counter(try_scenario(mutator, folder) for _ in range(count))
