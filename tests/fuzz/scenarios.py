"""Mutated scenario files: each ends in a run, or in the one error that is exit code 2."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from forked import Outcomes, try_forked
from mutation import Mutator
from urdfs import try_urdf

from controller.laws import TORQUE_LAWS
from deploy.run.network.links import check_link
from deploy.run.simulate import simulate
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.yaml_files import ScenarioError, leaves, plain, set_value

_TICKS = 3
_SNIPPETS = (
    "2024-13-45", "2024-02-30 25:61:61", "!!int z", "!!float x", "!!bool 7", "!!timestamp q",
    "9" * 5000, "0x" + "f" * 4000, "1e300", "1e308", "-1e308", "1e-308", "true", "[true, false]",
    "~", ".nan", ".inf", "[" * 3000 + "]" * 3000, "[" * 100_000, "{a: " * 60 + "1" + "}" * 60,
    "&a [*a]", "*a", "&a", "!x 1", "&a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]", "[*a, *a, *a, *a, *a, *a]",
    "!!binary z", "!!set {a}", "!!omap [a: 1]", "!!python/object:os.system x", "x" * 5000, "1:2:3",
    "'", '"', "|", ">", "{<<: 5}", "? [1]", "- 1", "\t", "%TAG", "---", "...", "nowhere:Law",
    "\u202e", "\\u0000", "../..", "/", "/dev/zero",
)  # fmt: skip
_EXTREMES = (0, -1, 1e-300, 1e-30, 1e-9, 1e-3, 3, 1e3, 1e6, 1e9, 1e12, -1e12, 1e13, 1e300)


@cache
def _sources() -> tuple[str, ...]:
    shipped = sorted(SHIPPED.rglob("*.yaml"))
    return tuple(path.read_text() for path in shipped)


def mutated_scenario(mutator: Mutator) -> str:
    """A shipped scenario, mutated by its text, by its lines or by its values."""
    source = mutator.choose(_sources())
    if mutator.chance(0.2):
        return mutator.text(source)
    if mutator.chance(0.3):
        return _with_snippets(mutator, source)
    if mutator.chance(0.5):
        return _with_extreme(mutator)
    return yaml.safe_dump(mutator.values(yaml.safe_load(source)))


@cache
def _whole(name: str, law: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """A shipped scenario with every default written out, and the dotted keys of its numbers."""
    switched_on = ["controller.delay_compensation.enabled", "controller.drive_feedback.enabled"]
    on = [f"{key}=true" for key in switched_on] * (law != "pid")
    setup = load_setup(name, [f"controller.law={law}", *on])
    values = yaml.safe_load(effective_scenario(setup))
    gains = plain(setup.gains)
    values["controller"]["gains"] = {law: gains}
    numbers = (key for key, value in leaves(values) if isinstance(value, int | float | list))
    return values, tuple(numbers)


def _with_extreme(mutator: Mutator) -> str:
    """A scenario with one number or two at the end of their range, or beyond."""
    name = mutator.choose(("paper_arm", "iiwa"))
    values, keys = _whole(name, mutator.choose(tuple(TORQUE_LAWS)))
    values = copy.deepcopy(values)
    for _ in range(mutator.choose((1, 2))):
        set_value(values, mutator.choose(keys), mutator.choose(_EXTREMES))
    return yaml.safe_dump(values)


def _with_snippets(mutator: Mutator, source: str) -> str:
    lines = source.splitlines()
    for _ in range(mutator.choose((1, 1, 2, 3))):
        index = mutator.choose(range(len(lines)))
        key = lines[index].partition(":")[0]
        kept = key + ": " if ":" in lines[index] and mutator.chance(0.9) else ""
        lines[index] = kept + mutator.choose(_SNIPPETS)
    return "\n".join(lines)


def try_scenario(mutator: Mutator, folder: Path) -> str:
    """Mutate a scenario; ``ran`` or ``refused``."""
    file = folder / "mutated.yaml"
    file.write_text(mutated_scenario(mutator), errors="surrogatepass")
    try:
        setup = load_setup(str(file))
        check_link(setup, one_process=True)
    except ScenarioError as error:
        assert str(file) in str(error), str(error)
        assert len(str(error)) < 50_000
        return "refused"
    period_s = setup.grid.period_ns * 1e-9
    short = [f"duration_s={_TICKS * period_s}", "plant.gui=false"]
    try:
        setup = load_setup(str(file), short)
    except ScenarioError:  # a fault that begins later, for one
        return "loaded"
    simulate(setup)
    return "ran"


_TRIALS = {"scenario": try_scenario, "urdf": try_urdf}


def try_files(kind: str, numbers: range, seed: int, folder: Path) -> Outcomes:
    """Trials with mutated files.

    Args:
        kind: ``scenario`` or ``urdf``.
        numbers: of the trials; with the seed they say all about them.
        seed: another one gives other mutations.
        folder: for the files.
    """
    return try_forked(lambda number: _TRIALS[kind](Mutator([seed, number]), folder), numbers)
