"""A table of arms without tuned gains: do laws with derived gains keep their bounds there.

    python -m scripts.experiments.arms_of_others FILE.jsonl [--laws A,B] [--rows A,B] [--arms A,B]
        [--plants N] [--random N] [--without-identification] [--picture FILE.svg]

Every arm gets its starter scenario (`deploy.scenario.starter`): rest to rest at 30 % of the joints'
speeds, with rotors and friction of its file or, where that has none, estimated ones. Each row of
the table is simulated with a nominal model that is 20 % too light and one that is 25 % too heavy,
or with plants drawn from the shipped half ranges. The arms come with the packages
``example-robot-data`` and ``pybullet``; joints of grippers and of the rest of a robot are held.
Further arms are made at random. What is in the file already is not simulated again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

from pydantic import TypeAdapter

from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.resolved import pybullet_data
from deploy.run.execute import execute
from deploy.scenario.scenario import build_setup, load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.starter import starter_scenario
from deploy.scenario.uncertainty import Uncertainty, draw_plant
from deploy.scenario.yaml_files import plain, read_yaml
from deploy.study.plants import RANGES
from deploy.study.quantities import build_quantity
from scripts.experiments.random_arms import write_random_arm

ROUND_TRIP = build_quantity("delay", "both", running=False, base=load_setup("paper_arm"))
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
SCALES = (0.8, 1.25)
LONGEST_S = 8.0
"""No run is longer: the arms that move slowest come to no further move."""
GEAR_HZ = 15.0
"""First resonance of elastic gears, the rotors held."""


class Row(NamedTuple):
    """A row of the table: a compensated round trip, and what else is set.

    Attributes:
        delay_ms: round trip, half each way; 0 for no delay and no compensation.
        running: whether it comes gradually, to a loop that already runs.
        is_drawn: plants are drawn from the half ranges, in place of the three nominal models.
        drives: whether the drives close a loop of their own.
        encoder_side: of elastic gears; empty for rigid ones.
    """

    delay_ms: float = 0.0
    running: bool = False
    is_drawn: bool = False
    drives: bool = False
    encoder_side: str = ""

    def overrides(self) -> list[str]:
        words = []
        if self.delay_ms:
            words.append("controller.delay_compensation.enabled=true")
            words += ROUND_TRIP.overrides(self.delay_ms, running=self.running)
        if self.encoder_side:
            words.append(f"plant.actuator.gear_resonance_hz={GEAR_HZ}")
            words.append(f"plant.actuator.encoder_side={self.encoder_side}")
        if self.drives:
            words.append("controller.drive_feedback.enabled=true")
        return words


ROWS = {
    "no delay": Row(),
    "16 ms": Row(16.0),
    "48 ms running": Row(48.0, running=True),
    "16 ms half": Row(16.0, is_drawn=True),
    "48 ms running drives half": Row(48.0, running=True, is_drawn=True, drives=True),
    "15 Hz gears": Row(encoder_side="motor"),
    "15 Hz gears by the link": Row(encoder_side="link"),
}


class Case(NamedTuple):
    """One simulation: a row, a factor on the nominal model or the number of a drawn plant."""

    row: str
    law: str
    arm: str
    variant: float
    identify: bool


def setup_of(case: Case, more: tuple[str, ...] = ()) -> Setup:
    """The scenario of a simulation."""
    row, (robot, values) = ROWS[case.row], starter(case.arm)
    words = [f"controller.law={case.law}", *row.overrides()]
    words += [f"duration_s={min(LONGEST_S, values['duration_s'])}", *more]
    if not case.identify:
        words.append("controller.delay_compensation.identify_model=false")
    if not row.is_drawn:
        words.append(f"controller.model_scale={case.variant}")
    setup = build_setup(values, robot.path, words)
    if row.is_drawn:
        ranges = TypeAdapter(Uncertainty).validate_python(read_yaml(RANGES / "half.yaml"))
        scenario, joints = plain(setup.scenario), setup.robot.joints
        drawn = draw_plant(ranges, scenario, joints, seed=1, number=int(case.variant))
        words += drawn.overrides
    return build_setup(values, robot.path, words) if row.is_drawn else setup


@cache
def starter(arm: str) -> tuple[RobotDescription, dict[str, Any]]:
    """An arm and its starter scenario."""
    if arm.startswith("random"):
        robot = load_robot(write_random_arm(Path(mkdtemp()), int(arm.removeprefix("random"))))
        return robot, starter_scenario(robot)
    file, starts = ARMS[arm]
    path = next(path for folder in _folders() if (path := folder / file).exists())
    whole = load_robot(path, repair=True)
    begin = tuple(starts.split()) or ("",)
    chosen = [name for name in whole.joint_names if name.startswith(begin)]
    robot = load_robot(path, chosen, repair=True)
    return robot, starter_scenario(robot)


def result(case: Case, more: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the result of a simulation."""
    summary = execute(setup_of(case, more)).summary
    bounds, rms = summary["bounds"], summary["tracking"]["rms_rad"]
    return {
        **case._asdict(),
        "verdict": summary["verdict"],
        "outside": bounds["violation_fraction"],
        "first_s": bounds.get("first_violation_s"),
        "margin": bounds["margin_min"],
        "rms_mrad": None if rms is None else round(1e3 * max(rms), 4),
    }


def cases(given: argparse.Namespace) -> Iterator[Case]:
    """All simulations that are asked for."""
    arms = given.arms or [*ARMS, *(f"random{seed}" for seed in range(1, given.random + 1))]
    for row, law, arm in product(given.rows, given.laws, arms):
        variants = range(1, given.plants + 1) if ROWS[row].is_drawn else SCALES
        for variant in variants:
            if not given.without_identification or ROWS[row].delay_ms:
                yield Case(row, law, arm, float(variant), not given.without_identification)


def main() -> None:
    """Simulate what is asked for and not yet in the file, and print the table of the file."""
    parser = argparse.ArgumentParser(description=__doc__)

    def words(text: str) -> list[str]:
        return text.split(",")

    parser.add_argument("file", type=Path)
    parser.add_argument("--laws", type=words, default=["fixed_time_adaptive"])
    parser.add_argument("--rows", type=words, default=[*ROWS])
    parser.add_argument("--arms", type=words, default=[])
    parser.add_argument("--plants", type=int, default=4)
    parser.add_argument("--random", type=int, default=20)
    parser.add_argument("--without-identification", action="store_true")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    done = _read(given.file)
    with given.file.open("a", encoding="utf-8") as stream:
        for case in cases(given):
            if case not in done:
                done[case] = result(case)
                stream.write(json.dumps(done[case]) + "\n")
                stream.flush()
    print("\n".join(table(done)))
    if given.picture:
        given.picture.write_text(picture(done, given.laws[0]), encoding="utf-8")


def table(done: dict[Case, dict[str, Any]]) -> Iterator[str]:
    """The table: of so many arms and simulations of each row, how many were kept."""
    yield "| row | law | identified | arms | all of the arm kept | simulations kept | not kept |"
    yield "|---|---|---|---|---|---|---|"
    groups = dict.fromkeys((case.row, case.law, case.identify, _is_random(case)) for case in done)
    for row, law, identify, is_random in groups:
        own = {
            case: each["verdict"] == "kept"
            for case, each in done.items()
            if (case.row, case.law, case.identify, _is_random(case))
            == (row, law, identify, is_random)
        }
        arms = dict.fromkeys(case.arm for case in own)
        lost = {arm: sum(not kept for case, kept in own.items() if case.arm == arm) for arm in arms}
        whole = sum(not each for each in lost.values())
        named = ", ".join(f"{arm} {times}" for arm, times in lost.items() if times)
        yield (
            f"| {row} | `{law}` | {'yes' if identify else 'no'} |"
            f" {'at random' if is_random else 'of others'} | {whole} of {len(arms)} |"
            f" {sum(own.values())} of {len(own)} | {named or '–'} |"
        )


def picture(done: dict[Case, dict[str, Any]], law: str) -> str:
    """An SVG of arms by rows of the table: how many simulations were kept, and the worst RMS."""
    own = {case: each for case, each in done.items() if case.law == law and case.identify}
    rows = list(dict.fromkeys(case.row for case in own))
    arms = list(dict.fromkeys(case.arm for case in own))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{130 + 120 * len(rows)}"'
        f' height="{50 + 18 * len(arms)}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for column, row in enumerate(rows):
        x = 120 + 120 * column
        parts += [
            f'<text x="{x}" y="{14 + 13 * line}">{" ".join(words)}</text>'
            for line, words in enumerate((row.split()[:2], row.split()[2:]))
        ]
        for line, arm in enumerate(arms):
            y = 36 + 18 * line
            there = [each for c, each in own.items() if (c.row, c.arm) == (row, arm)]
            kept = [each["verdict"] == "kept" for each in there]
            if column == 0:
                parts.append(f'<text x="4" y="{y + 12}">{arm}</text>')
            if kept:
                colour = "#3a9" if all(kept) else "#e90" if any(kept) else "#c33"
                worst = max(each["rms_mrad"] or math.nan for each in there)
                text = f"{sum(kept)} of {len(kept)}, {worst:.2g} mrad"
                parts += [
                    f'<rect x="{x}" y="{y}" width="112" height="16" fill="{colour}"/>',
                    f'<text x="{x + 6}" y="{y + 12}" fill="white">{text}</text>',
                ]
    return "\n".join([*parts, "</svg>"])


def _is_random(case: Case) -> bool:
    return case.arm.startswith("random")


def _read(file: Path) -> dict[Case, dict[str, Any]]:
    """Return the content of a file, by case."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    found = (json.loads(line) for line in lines)
    return {Case(*(each[name] for name in Case._fields)): each for each in found}


def _folders() -> list[Path]:
    """Return the folders of the packages' arms."""
    inside = Path("cmeel.prefix/share/example-robot-data/robots")
    return [*(Path(path) / inside for path in sys.path), *pybullet_data()]


if __name__ == "__main__":
    main()
