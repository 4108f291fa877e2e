"""The table of what delay compensation gains and costs: the smallest margins with it and without.

    python -m scripts.experiments.compensation_table [--arms A,B] [--rotors X,Y] [--delays MS,MS]
        [--networks A,B] [--starts S,S] [--laws A,B] [--duration S] [--set KEY=VALUE]… [--only on]

An arm is a shipped scenario, or the file of an arm, which gets its starter scenario. Its rotors are
scaled in plant and nominal model alike. A delay is a round trip, half each way; on a network both
directions follow a shipped trace, from each start. Margins are in bounds, 1 − |e| / bound, the
smallest over the run and all joints; a simulation ends a second after the arm is lost.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from multiprocessing import get_context
from typing import NamedTuple

from deploy.run.execute import InProcess
from deploy.scenario.scenario import load_setup
from plant_emulator.plant_loop import PlantLoop

AFTER_LOSS_S = 1.0
_ROTORS = "plant.actuator.rotor_inertia_kg_m2"


class Case(NamedTuple):
    """A row of the table, and the settings of its simulations."""

    arm: str
    law: str
    rotors: float
    link: str
    link_words: tuple[str, ...]

    def overrides(self) -> list[str]:
        words = [f"controller.law={self.law}"] if self.law else []
        if self.rotors != 1.0:
            own = load_setup(self.arm)
            inertia = own.scenario.plant.actuator.rotor_inertia(own.robot.joints)
            assert inertia is not None, f"{self.arm} has no rotors"
            words.append(f"{_ROTORS}={(self.rotors * inertia).tolist()}")
        return [*words, *self.link_words]


def margin(case: Case, more: Sequence[str]) -> float:
    """Return the smallest margin of a simulation; -inf if it ended with a fault."""
    watched: list[PlantLoop] = []

    def watch(plant: PlantLoop) -> None:
        plant.end_after_loss(AFTER_LOSS_S)
        watched.append(plant)

    run = InProcess(on_start=watch).run(load_setup(case.arm, [*case.overrides(), *more]), None)
    smallest = run.summary["bounds"]["margin_min"]
    return float("-inf") if smallest is None or run.summary["faults"] else float(smallest)


def _both(more: Sequence[str], only: str, case: Case) -> dict[str, float]:
    key = "controller.delay_compensation.enabled"
    states = {"off": "false", "on": "true"}
    return {
        name: margin(case, [f"{key}={value}", *more])
        for name, value in states.items()
        if only in ("", name)
    }


def cases(given: argparse.Namespace) -> Iterator[Case]:
    """All rows that are asked for."""
    sides = "uplink", "downlink"
    links = [
        (f"{delay} ms", tuple(f"link.{side}.delay_ms={delay / 2}" for side in sides))
        for delay in given.delays
    ]
    for network, start in product(given.networks, given.starts):
        traces = [f"link.{side}.trace={{file: {network}, start_s: {start}}}" for side in sides]
        links.append((f"{network} {start}", (*traces, "plant.command_timeout_ms=1000")))
    for arm, law, rotors, (link, words) in product(given.arms, given.laws, given.rotors, links):
        yield Case(arm, law, rotors, link, words)


def main() -> None:
    """Simulate what is asked for, and print the table as the simulations end."""
    parser = argparse.ArgumentParser(description=__doc__)

    def words(text: str) -> list[str]:
        return text.split(",")

    def numbers(text: str) -> list[float]:
        return [float(each) for each in words(text)]

    motors = "panda_motors,iiwa_motors,ur5e_motors,ur10e_motors,openarm"
    parser.add_argument("--arms", type=words, default=words(motors))
    parser.add_argument("--rotors", type=numbers, default=[1.0])
    parser.add_argument("--delays", type=numbers, default=[])
    parser.add_argument("--networks", type=words, default=[])
    parser.add_argument("--starts", type=words, default=["0", "15", "30", "45", "10.49"])
    parser.add_argument("--laws", type=words, default=[""])
    parser.add_argument("--duration", type=float, default=3.0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--only", choices=["on", "off"], default="")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    more = [f"duration_s={given.duration}", *given.set]
    print("| arm | law | rotors | link | without | with |\n|---|---|---|---|---|---|")
    with get_context("spawn").Pool(given.workers) as pool:
        rows = list(cases(given))
        found_all = pool.imap(partial(_both, more, given.only), rows)
        for row, found in zip(rows, found_all, strict=True):
            shown = " | ".join(f"{found[n]:.3f}" if n in found else "" for n in ("off", "on"))
            named = f"{row.arm} | {row.law} | × {row.rotors:g} | {row.link}"
            print(f"| {named} | {shown} |", flush=True)


if __name__ == "__main__":
    main()
