"""A table of arms that nobody tuned for: do laws with derived gains keep their bounds there.

    python -m scripts.experiments.arms_of_others [--plants N] [--laws A,B]

Every arm gets its starter scenario (`deploy.scenario.starter`): rest to rest at 30 % of the joints'
speeds, estimated rotors, friction of 3 % of the largest torques. It is simulated without delay and
over compensated round trips, with the nominal model as it is, 20 % too light and 25 % too heavy, or
with plants drawn from the shipped half ranges. The arms come with the packages
``example-robot-data`` and ``pybullet``; joints of grippers and of the rest of a robot are held.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter

from bus_schema.robot_description import load_robot
from bus_schema.urdf.resolved import pybullet_data
from deploy.run.execute import execute
from deploy.scenario.scenario import build_setup
from deploy.scenario.starter import starter_scenario
from deploy.scenario.uncertainty import Uncertainty, draw_plant
from deploy.scenario.yaml_files import plain, read_yaml
from deploy.study.plants import RANGES

_UR, _SO = "ur_description/urdf", "so_arm_description/urdf"
ARMS: dict[str, tuple[str, str]] = {
    "ur3": (f"{_UR}/ur3_robot.urdf", ""), "ur5": (f"{_UR}/ur5_robot.urdf", ""),
    "ur10": (f"{_UR}/ur10_robot.urdf", ""), "kinova": ("kinova_description/robots/kinova.urdf", ""),
    "talos": ("talos_data/robots/talos_left_arm.urdf", ""),
    "so100": (f"{_SO}/so100.urdf", ""), "so101": (f"{_SO}/so101.urdf", ""),
    "z1": ("z1_description/urdf/z1.urdf", ""), "panda": ("panda_description/urdf/panda.urdf", ""),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", ""),
    "two_dof": ("asr_twodof_description/urdf/TwoDofs.urdf", ""),
    "tiago": ("tiago_description/robots/tiago.urdf", "arm_"),
    "tiago_pro": ("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_"),
    "baxter": ("baxter_description/urdf/baxter.urdf", "left_"),
    "centauro": ("centauro_description/urdf/centauro.urdf", "j_arm1_"),
    "pr2": ("pr2_description/urdf/pr2.urdf", "l_shoulder l_upper l_elbow l_forearm l_wrist"),
    "g1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", "left_shoulder left_elbow left_wrist"),
    "alex": ("alex_description/urdf/alex_nub_hands.urdf", "LeftShoulder LeftElbow LeftWrist"),
    "xarm6": ("xarm/xarm6_robot.urdf", ""), "iiwa": ("kuka_iiwa/model.urdf", ""),
}  # fmt: skip
"""A file of one of the packages, and how the names of the arm's joints begin."""
DELAYS_MS = (0, 16, 48)
SCALES = (0.8, 1.0, 1.25)


class Case(NamedTuple):
    """One simulation: a factor on the nominal model, or the number of a drawn plant."""

    arm: str
    law: str
    delay_ms: float
    model_scale: float | None
    plant: int | None


def kept(case: Case) -> bool:
    """Whether the arm kept its bounds."""
    file, starts = ARMS[case.arm]
    path = next(path for folder in _folders() if (path := folder / file).exists())
    whole = load_robot(path, repair=True)
    begin = tuple(starts.split()) or ("",)
    chosen = [name for name in whole.joint_names if name.startswith(begin)]
    robot = load_robot(path, chosen, repair=True)
    values = starter_scenario(robot, joints=True, repair=True)
    words = [f"controller.law={case.law}"]
    if case.delay_ms:
        words += ["controller.delay_compensation.enabled=true"]
        words += [f"link.{way}.delay_ms={0.5 * case.delay_ms}" for way in ("uplink", "downlink")]
    if case.model_scale is not None:
        words.append(f"controller.model_scale={case.model_scale}")
    if case.plant is not None:
        setup = build_setup(values, path, words)
        ranges = TypeAdapter(Uncertainty).validate_python(read_yaml(RANGES / "half.yaml"))
        scenario, joints = plain(setup.scenario), setup.robot.joints
        drawn = draw_plant(ranges, scenario, joints, seed=1, number=case.plant)
        words += drawn.overrides
    return bool(execute(build_setup(values, path, words)).summary["verdict"] == "kept")


def cases(laws: list[str], plants: int) -> Iterator[Case]:
    """All simulations of the table."""
    for arm, law, delay_ms in product(ARMS, laws, DELAYS_MS):
        for scale in SCALES:
            yield Case(arm, law, delay_ms, scale, None)
        for plant in range(1, plants + 1):
            yield Case(arm, law, delay_ms, None, plant)


def main() -> None:
    """Print a table: of so many simulations of each law and round trip, how many were kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=4)
    parser.add_argument("--laws", default="fixed_time_adaptive,fixed_time_neural")
    given = parser.parse_args()
    wanted = list(cases(given.laws.split(","), given.plants))
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = dict(zip(wanted, pool.map(kept, wanted), strict=True))
    print("| law | round trip | model × 0.8, 1, 1.25 | half ranges | not kept |")
    print("|---|---|---|---|---|")
    for law, delay_ms in product(given.laws.split(","), DELAYS_MS):
        own = {case: is_kept for case, is_kept in found.items() if case[1:3] == (law, delay_ms)}
        exact = [is_kept for case, is_kept in own.items() if case.plant is None]
        drawn = [is_kept for case, is_kept in own.items() if case.plant is not None]
        lost = sorted({case.arm for case, is_kept in own.items() if not is_kept})
        print(
            f"| `{law}` | {delay_ms} ms | {sum(exact)} of {len(exact)} | {sum(drawn)} of"
            f" {len(drawn)} | {', '.join(lost) or '–'} |"
        )


def _folders() -> list[Path]:
    """Where the packages keep their arms."""
    inside = Path("cmeel.prefix/share/example-robot-data/robots")
    return [*(Path(path) / inside for path in sys.path), *pybullet_data()]


if __name__ == "__main__":
    main()
