"""Whether verdicts outlive another physics: scenarios on Bullet, and on pinocchio with RK4.

``python -m deploy.experiments.independent_check runs/my-study/scenarios/*.yaml`` simulates each
scenario twice with the same controller, channel and hardware: with Bullet's rigid bodies, and with
those of `runge_kutta_arm`. Verdicts that differ where both margins are clear of zero end it with
exit code 1; nearer than `MARGINAL` to zero either integrator may be right.
"""

from __future__ import annotations

import argparse
import glob
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from bus_schema.recording.atomic_files import write_json
from deploy.exit_codes import BAD_INPUT, FAULT
from deploy.experiments.runge_kutta_arm import RungeKuttaArm
from deploy.input_error import InputError
from deploy.runs.judging.metrics import summarise
from deploy.runs.run_folder import provenance
from deploy.runs.simulate import attempt
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.arm.arm_plant import ArmPlant

MARGINAL = 0.03
"""A smallest margin nearer to zero than this share of the bound decides nothing."""


@dataclass(frozen=True)
class Verdict:
    """What became of a run.

    Attributes:
        kept: it came to its end, and its errors stayed inside the funnel.
        margin_min: smallest distance to the bound as a share of it; None without data.
        faults: what went wrong.
    """

    kept: bool
    margin_min: float | None
    faults: list[str]


@dataclass(frozen=True)
class Comparison:
    """A scenario on both kinds of physics."""

    scenario: str
    bullet: Verdict
    runge_kutta: Verdict

    @property
    def agrees(self) -> bool:
        return self.bullet.kept == self.runge_kutta.kept

    @property
    def is_marginal(self) -> bool:
        """Whether one of the margins is too near to zero to decide anything."""
        margins = (self.bullet.margin_min, self.runge_kutta.margin_min)
        return any(margin is not None and abs(margin) < MARGINAL for margin in margins)


def check_physics_can_be_replaced(setup: Setup) -> None:
    """Check that a scenario's arm is one whose physics can be replaced.

    Raises:
        ScenarioError: it has motor drives, whose brakes hold single joints.
    """
    kind = setup.scenario.link.kind
    if setup.link_kind.arm_type is not ArmPlant:
        raise ScenarioError(
            f"{setup.origin.of('link.kind')}: link.kind = {kind!r}: must be zenoh or in_process"
            " for this check"
        )


def compare(name: str, setup: Setup) -> Comparison:
    """Simulate a scenario on both."""
    independent = replace(setup, bodies=RungeKuttaArm)
    return Comparison(name, _verdict(setup), _verdict(independent))


def _verdict(setup: Setup) -> Verdict:
    summary = summarise(attempt(setup).data())
    bounds, faults = summary["bounds"], summary["faults"]
    kept = bool(bounds["kept"] and summary["completed"] and not faults)
    return Verdict(kept, bounds["margin_min"], faults)


HEADINGS = (
    "scenario", "Bullet", "smallest margin", "RK4", "smallest margin", "equal", "marginal"
)  # fmt: skip


def rows(found: Iterator[Comparison]) -> Iterator[str]:
    """A table in Markdown, line by line."""
    for line in (HEADINGS, ("---",) * len(HEADINGS), *map(_cells, found)):
        yield f"| {' | '.join(line)} |"


def _cells(of: Comparison) -> tuple[str, ...]:
    return (
        of.scenario,
        *(cell for verdict in (of.bullet, of.runge_kutta) for cell in _judged(verdict)),
        "yes" if of.agrees else "**no**",
        "yes" if of.is_marginal else "",
    )


def _judged(verdict: Verdict) -> tuple[str, str]:
    margin = "–" if verdict.margin_min is None else f"{100.0 * verdict.margin_min:.1f} %"
    return ("kept" if verdict.kept else "lost"), margin


def files_of(patterns: Sequence[str]) -> list[str]:
    """Scenario files and names of shipped scenarios; a pattern stands for the files that fit it.

    Raises:
        ScenarioError: no file fits.
    """
    found: list[str] = []
    for pattern in patterns:
        files = sorted(glob.glob(pattern)) if glob.has_magic(pattern) else [pattern]  # noqa: PTH207
        if not files:
            raise ScenarioError(f"{pattern}: must fit one file or more")
        found += files
    return found


def main() -> None:
    """Print the table, and write what is behind it where that is asked for."""
    parser = argparse.ArgumentParser(description="Scenarios on Bullet, and on pinocchio with RK4.")
    parser.add_argument("scenarios", nargs="+", help="files, patterns or names")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--json", dest="json_file", type=Path, metavar="FILE")
    options = parser.parse_args()
    try:
        setups = {name: load_setup(name, options.overrides) for name in files_of(options.scenarios)}
        for setup in setups.values():
            check_physics_can_be_replaced(setup)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    found: list[Comparison] = []

    def comparisons() -> Iterator[Comparison]:
        for name, setup in setups.items():
            found.append(compare(Path(name).stem, setup))
            yield found[-1]

    for row in rows(comparisons()):
        print(row, flush=True)
    differing = [each.scenario for each in found if not (each.agrees or each.is_marginal)]
    if options.json_file is not None:
        results = {**provenance(), "scenarios": [asdict(each) for each in found]}
        write_json(options.json_file, results)
    if differing:
        print(f"different: {', '.join(differing)}", file=sys.stderr)
        sys.exit(FAULT)


if __name__ == "__main__":
    main()
