"""Every arm file of a folder, tried as a stranger would: does it open, and does it keep its bounds.

    python -m scripts.experiments.arms_tried FILE.jsonl FOLDER … [--page FILE.md] [--limit SECONDS]

Folders are those of vendors' repositories, and of unpacked packages with robots, such as
``example-robot-data``, ``rtb-data``, ``robosuite`` and ``manipulapy``. Each URDF, xacro and MJCF
file is opened as ``funnel-hil robot`` opens it. A missing argument of a xacro file gets the first
value that the error message names, and ``arm`` if it names none; where the message advises
``--repair``, it is given. Of a whole robot the arm with the longest reach is driven. Files without
a joint (macros, materials) do not count, nor do those of `NO_ARMS`. Each arm is compared with
pinocchio's own reading of its URDF, or MuJoCo's of its MJCF, and simulated from its starter
scenario, with the default law and derived gains, with an exact nominal model and two
wrong ones. What is in FILE.jsonl already is not tried again. ``--page`` writes the rates to FILE.md
and a line for each file to FILE.csv beside it.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shlex
import signal
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio

from bus_schema.arrays import Vector
from bus_schema.errors import InputError, RobotDescriptionError
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.chains import chains_of, chosen_joints
from bus_schema.urdf.checks import mass_of
from bus_schema.urdf.link_tree import LinkTree
from controller.manipulator_model import ManipulatorModel, spread_positions
from deploy.cli.robot import at_rest, robot_warnings
from deploy.run.execute import execute
from deploy.scenario.checking.checks import check_plant
from deploy.scenario.checking.plausibility import loads_of
from deploy.scenario.scenario import build_setup
from deploy.scenario.starter import ESTIMATED, drives_of, starter_scenario
from scripts.experiments.arms_of_others import ROWS

SUFFIXES = (".urdf", ".xacro", ".xml", ".mjcf")
NO_ARMS = re.compile(
    r"package\.xml$|scene|keyframe|actuators|_hand\b|/hand|hand/|gripper\.(?!urdf)|pump|/ee/|go1/"
    r"|pr2_no_arms|cia402|robot_controller|macro|srdf|gazebo\.|transmission|ros2_control|_mount|_cover"
    r"|spot\.xml|fr3_duo_arm|_base\.urdf|base\.xml|laikago|go[12]_|allegro|anymal\.urdf|hyq|b1\.urdf"
    r"|/robotiq|collision\.urdf|/hands?/|gripper/|hand_mk|wrist_mk|d4[03]5|/spot/|/go2/|pump|ridgeback"
    r"|xxm[sd]\.|/xacro/stretch|al5d_mount|conf/|environment/|mobile_platforms|cameras/|_hands_and"
    r"|hextilt|borinot|/human|lower|bolt|iris|finger_edu|pendulum|a1_desc|quadr|solo|anymal_c"
)
"""Tools, scenes around an arm, robots without arms, and parts that other files include."""
RUNS = {"no delay": ROWS["no delay"], "16 ms": ROWS["16 ms"], "48 ms": ROWS["48 ms running"]}
SCALES = (1.0, 0.8, 1.25)
"""Factors on the nominal model."""
DURATION_S = 4.0
_VENDOR = re.compile(r"^\d+-|_description$|_data$")
NO_JOINT = re.compile("has no revolute|neither URDF nor MJCF")
_OF_LEGS = re.compile("hip|knee|ankle|leg|foot|sole|wheel|thumb", re.IGNORECASE)
GOALS = {"no delay": 98, "16 ms": None, "48 ms": 93}
"""Shares that are aimed at, per cent."""
_MISSING = re.compile(
    r"(?:(\w+):=… gives it|the argument (\w+) is '[^']*')"
    r"(?:.*; its files (?:know|compare it with) ([^\s,;]+))?"
)
_MOST_ARGUMENTS = 8
_WHOLE_ROBOT = 3
_POSTURES = 20
_REASON = 160

Terms = Callable[[Vector], tuple[Vector, Vector]]
"""Returns the inertia of each joint and its torque of gravity in a posture."""


def tried(path: Path, folder: Path) -> dict[str, Any]:
    """Return what became of a file: how it opened, what it moves, and the verdicts of its runs."""
    row: dict[str, Any] = {
        "vendor": path.relative_to(folder).parts[0],
        "file": str(path.relative_to(folder)),
        "command": f"funnel-hil robot {path.name}",
    }
    try:
        arm, words = opened(path)
        row["command"] = shlex.join(["funnel-hil", "robot", path.name, *words])
        row |= facts(arm)
        values = starter_scenario(arm)
        check_plant(build_setup(values, arm.path))
        row["opens"], row["difference"] = True, difference(arm)
    except (InputError, RobotDescriptionError) as error:
        return {**row, "opens": False, "reason": _short(error, folder)}
    for name, run in RUNS.items():
        row[name] = [
            verdict(values, arm.path, [*run.overrides(), f"controller.model_scale={scale}"])
            for scale in SCALES
        ]
    return row


def opened(path: Path) -> tuple[RobotDescription, list[str]]:
    """Return an arm and the words after the file in the command that opens it.

    Raises:
        InputError: it does not open.
    """
    arguments, repair = dict[str, str](), False
    read = partial(load_robot, path, arguments=arguments, hold_grippers=True)
    for _ in range(_MOST_ARGUMENTS):
        try:
            arm = read(repair=repair)
            break
        except RobotDescriptionError as error:
            missing = _MISSING.search(str(error))
            name = missing and (missing[1] or missing[2])
            if missing and name and name not in arguments:
                arguments[name] = missing[3] or "arm"
            elif "--repair" in str(error) and not repair:
                repair = True
            else:
                raise
    else:
        raise InputError(f"more than {_MOST_ARGUMENTS} arguments are missing")
    words = [f"{name}:={value}" for name, value in arguments.items()] + ["--repair"] * repair
    root = ET.fromstring(arm.text)
    chains = [c for c in chains_of(root, arm.joint_names) if len(c.joints) >= _WHOLE_ROBOT]
    if len(chains) < 2:
        return arm, words
    best = max(chains, key=lambda c: (not any(map(_OF_LEGS.search, (*c.joints, c.tip))), c.reach_m))
    tip = best.tip
    joints = chosen_joints(root, arm.joint_names, tip)
    return read(joints, repair=repair), [*words, "--chain", tip]


def facts(arm: RobotDescription) -> dict[str, Any]:
    """Return joints, mass, estimates, load and warnings of an arm."""
    tree, drives = LinkTree(ET.fromstring(arm.text)), drives_of(arm)
    moved = (each for name, each in tree.links.items() if tree.mover(name, {*arm.joint_names}))
    warnings = robot_warnings(at_rest(arm))
    estimates = [
        text.split(ESTIMATED)[0].removesuffix("from the arm's file and elsewhere ").strip()
        for text in drives.data.split(", ")
        if ESTIMATED in text
    ]
    if arm.estimated:
        estimates.insert(0, "inertias")
    return {
        "joints": arm.joints,
        "mass_kg": round(sum(map(mass_of, moved)), 3),
        "estimated": estimates,
        "load": round(float((loads_of(arm).gravity_nm / drives.rated).max()), 3),
        "names": [*arm.joint_names, arm.tip_link],
        "warnings": warnings,
    }


def difference(arm: RobotDescription) -> float | None:
    """Return the largest relative difference from a library's own reading of an arm's file.

    Of the moved mass, the inertia of each joint and the largest torque of gravity, in postures
    spread over the ranges; None where there is nothing to compare.
    """
    if arm.estimated or arm.followers or any("triangle rule" in each for each in arm.warnings):
        return None  # pinocchio and MuJoCo read impossible inertias, which are replaced here
    reader = _of_mujoco if arm.path.suffix in (".xml", ".mjcf") else _of_pinocchio
    try:
        mass_kg, terms = reader(arm)
    except (ValueError, KeyError, IndexError):  # it does not read this file
        return None
    model, worst = ManipulatorModel(arm), 0.0
    if mass_kg is not None:
        worst = abs(model.moved_kg - mass_kg) / mass_kg
    for posture in spread_positions(arm)[:_POSTURES]:
        inertia, gravity = terms(posture)
        own = np.diagonal(model.mass_matrix(posture)), model.gravity(posture)
        shares = [
            abs(own[0] - inertia) / inertia,
            abs(own[1] - gravity) / max(abs(gravity).max(), 1e-3),
        ]
        worst = max(worst, float(np.max(shares)))
    return worst


def _of_pinocchio(arm: RobotDescription) -> tuple[float | None, Terms]:
    text = arm.text if arm.path.suffix == ".xacro" else arm.path.read_text(encoding="utf-8")
    whole = pinocchio.buildModelFromXML(text)
    rest = pinocchio.neutral(whole)
    locked = [whole.getJointId(name) for name in whole.names[1:] if name not in arm.joint_names]
    model = pinocchio.buildReducedModel(whole, locked, rest)
    data, joints = model.createData(), [model.joints[model.getJointId(n)] for n in arm.joint_names]
    places = [joint.idx_v for joint in joints]

    def terms(posture: Vector) -> tuple[Vector, Vector]:
        position = pinocchio.neutral(model)
        for joint, angle in zip(joints, posture, strict=True):
            ends = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
            position[joint.idx_q : joint.idx_q + joint.nq] = ends
        mass = np.diagonal(pinocchio.crba(model, data, position))[places]
        return mass, pinocchio.computeGeneralizedGravity(model, data, position)[places]

    return float(sum(each.mass for each in model.inertias[1:])), terms


def _of_mujoco(arm: RobotDescription) -> tuple[float | None, Terms]:
    model = mujoco.MjModel.from_xml_path(str(arm.path))
    data, joints = mujoco.MjData(model), [model.joint(name) for name in arm.joint_names]
    places, model.opt.gravity[:] = [int(joint.dofadr[0]) for joint in joints], (0.0, 0.0, -9.81)
    model.body_gravcomp[:] = 0.0

    def terms(posture: Vector) -> tuple[Vector, Vector]:
        data.qpos[:] = 0.0
        free = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
        data.qpos[free + 3] = 1.0
        for joint, angle in zip(joints, posture, strict=True):
            data.qpos[int(joint.qposadr[0])] = angle
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        return (np.diagonal(full) - model.dof_armature)[places], data.qfrc_bias[places]

    return None, terms


def verdict(values: dict[str, Any], path: Path, overrides: Sequence[str]) -> str:
    """Return the verdict of a run, or why there is none."""
    try:
        setup = build_setup(values, path, [*overrides, f"duration_s={DURATION_S}"])
        return str(execute(setup).summary["verdict"])
    except (InputError, RobotDescriptionError) as error:
        return f"refused: {str(error)[:_REASON]}"


@contextmanager
def time_limit(limit_s: int) -> Iterator[None]:
    """Raise `TimeoutError` in a block that takes longer."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"no answer within {limit_s} s")

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(limit_s)
    try:
        yield
    finally:
        signal.alarm(0)


def files_of(folder: Path) -> list[Path]:
    """Return the files of a folder that may describe arms."""
    found = (path for path in sorted(folder.rglob("*")) if path.suffix in SUFFIXES)
    return [path for path in found if not NO_ARMS.search(str(path.relative_to(folder)))]


def page(rows: Sequence[dict[str, Any]], conditions: str, table: str) -> str:
    """Return the page with the rates, which offers the table with a line for each file."""
    arms = _arms(rows)
    read = [row for row in arms if row["opens"]]
    held = [row for row in read if row["load"] <= 1.0]
    found = [row["difference"] for row in read if row.get("difference") is not None]
    kept = [
        _rate(f"kept, {name}, {whose}", [_kept(row, name) for row in of], goal)
        for of, whose in ((held, "arms that have the torque"), (read, "all that open"))
        for name, goal in GOALS.items()
    ]
    lines = [
        "# Arms that were tried",
        "",
        "Arm files as their vendors and others ship them, each opened and simulated by one command"
        " without an edit.",
        "",
        f"| | arms | {' | '.join(f'model × {scale:g}' for scale in SCALES)} | goal |",
        "|---|---|---|---|---|---|",
        _rate("open", [[row["opens"]] * len(SCALES) for row in arms], 95),
        *kept,
        "",
        f"Mass, joint inertias and gravity of {len(found)} files differ by at most"
        f" {max(found, default=0.0):.1g} from pinocchio's or MuJoCo's own reading.",
        "",
        conditions,
        "",
        f"{{download}}`A line for each file <{table}>`.",
    ]
    return "\n".join(lines) + "\n"


def table(rows: Sequence[dict[str, Any]]) -> list[list[Any]]:
    """Return a heading and a line for each file."""
    columns = "vendor", "command", "joints", "mass_kg", "estimated", "gravity_by_torque", "warnings"
    return [[*columns, *RUNS], *map(_line, _arms(rows))]


def _arms(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    whole = (row for row in rows if not NO_ARMS.search(row["file"]))
    return [row for row in whole if not NO_JOINT.search(row.get("reason", ""))]


def _kept(row: dict[str, Any], run: str) -> list[bool]:
    return [each == "kept" for each in row[run]]


def _rate(what: str, kept: Sequence[Sequence[bool]], goal: int | None) -> str:
    count = max(len(kept), 1)
    shares = [100.0 * sum(column) / count for column in zip(*kept, strict=True)]
    texts = [f"{share:.0f} %" for share in shares] or ["–"] * len(SCALES)
    missed = goal is not None and min(shares, default=0.0) < goal
    aim = "–" if goal is None else f"{goal} %" + ", **missed**" * missed
    return f"| {what} | {len(kept)} | {' | '.join(texts)} | {aim} |"


def _line(row: dict[str, Any]) -> list[Any]:
    start = [_VENDOR.sub("", row["vendor"]), _cell(row["command"])]
    if not row["opens"]:
        return [*start, *[""] * 4, f"does not open: {_cell(row['reason'])}", *[""] * len(RUNS)]
    warnings = row["warnings"]
    return [
        *start, row["joints"], f"{row['mass_kg']:.3g}", ", ".join(row["estimated"]),
        f"{row['load']:.2g}", f"{len(warnings)}: {_cell(warnings[0])}" if warnings else "",
        *(_cell(", ".join(dict.fromkeys(row[name]) if len({*row[name]}) == 1 else row[name]))
          for name in RUNS),
    ]  # fmt: skip


def _cell(text: str) -> str:
    return re.sub(r"(?<!\w)/\S*/", "", text)[:_REASON]  # no folders of this machine


def _short(error: Exception, folder: Path) -> str:
    return str(error).replace(f"{folder}/", "")[: 2 * _REASON]


def main() -> None:
    """Try all files that are not in the table yet, and write its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--conditions", default="")
    parser.add_argument("--limit", type=int, default=120, help="seconds for each file")
    given = parser.parse_args()
    folders = [folder.resolve() for folder in given.folders]
    given.file.touch()
    rows = [json.loads(line) for line in given.file.read_text(encoding="utf-8").splitlines()]
    done = {row["file"] for row in rows}
    with given.file.open("a", encoding="utf-8") as stream:
        for folder, path in ((each, path) for each in folders for path in files_of(each)):
            if (name := str(path.relative_to(folder))) in done:
                continue
            try:
                with time_limit(given.limit):
                    row = tried(path, folder)
            except Exception as error:  # noqa: BLE001 (what a stranger would see as a traceback)
                reason = f"{type(error).__name__}: {error}"
                row = {"vendor": path.relative_to(folder).parts[0], "file": name, "opens": False,
                       "command": f"funnel-hil robot {path.name}", "reason": reason}  # fmt: skip
            rows.append(row)
            stream.write(json.dumps(row) + "\n")
            stream.flush()
    if given.page:
        name = f"{given.page.stem}.csv"
        given.page.write_text(page(rows, given.conditions, name), encoding="utf-8")
        with given.page.with_name(name).open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(table(rows))


if __name__ == "__main__":
    main()
