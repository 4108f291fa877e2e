"""Every arm file of a folder, tried as a stranger would: does it open, and does it keep its bounds.

    python -m scripts.experiments.arms_tried FILE.jsonl FOLDER … [--page FILE.md] [--limit SECONDS]

Each URDF, xacro and MJCF file is opened as ``funnel-hil robot`` opens it. A missing argument of a
xacro file gets the first value that the error message names, and ``arm`` if it names none; where
the message advises ``--repair``, it is given. Of a whole robot the arm with the longest reach is
driven. Files without a joint (macros, materials) do not count, nor do those of `NO_ARMS`. Each arm
is simulated from its starter scenario, with the default law and derived gains. What is in
FILE.jsonl already is not tried again.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import signal
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from bus_schema.errors import InputError, RobotDescriptionError
from bus_schema.robot_description import RobotDescription, load_robot
from bus_schema.urdf.chains import chains_of, chosen_joints
from bus_schema.urdf.checks import mass_of
from bus_schema.urdf.link_tree import LinkTree
from deploy.cli.robot import at_rest, robot_warnings
from deploy.run.execute import execute
from deploy.scenario.checking.checks import check_plant
from deploy.scenario.checking.plausibility import loads_of
from deploy.scenario.scenario import build_setup
from deploy.scenario.starter import ESTIMATED, drives_of, starter_scenario
from scripts.experiments.arms_of_others import ROWS

SUFFIXES = (".urdf", ".xacro", ".xml", ".mjcf")
NO_ARMS = re.compile(
    r"package\.xml$|scene|keyframe|actuators|_hand\b|/hand|hand/|gripper\.|/robotiq|pump|/ee/|go1/"
    r"|pr2_no_arms|cia402|robot_controller|macro|srdf|gazebo\.|transmission|ros2_control|_mount|_cover"
    r"|spot\.xml|fr3_duo_arm|_base\.urdf|base\.xml|laikago|go[12]_|allegro|anymal\.urdf|hyq|b1\.urdf"
    r"|hextilt|borinot|/human|lower|bolt|iris|finger_edu|pendulum|a1_desc|quadr|solo|anymal_c"
)
"""Tools, scenes around an arm, robots without arms, and parts that other files include."""
RUNS = {"no delay": ROWS["no delay"], "48 ms": ROWS["48 ms running"]}
DURATION_S = 4.0
_VENDOR = re.compile(r"^\d+-|_description$|_data$")
NO_JOINT = re.compile("has no revolute|neither URDF nor MJCF")
_OF_LEGS = re.compile("hip|knee|ankle|leg|foot|sole|wheel|thumb", re.IGNORECASE)
_MISSING = re.compile(
    r"(?:(\w+):=… gives it|the argument (\w+) is '[^']*')"
    r"(?:.*; its files (?:know|compare it with) ([^\s,;]+))?"
)
_MOST_ARGUMENTS = 8
_WHOLE_ROBOT = 3
_REASON = 160


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
        row["opens"] = True
    except (InputError, RobotDescriptionError) as error:
        return {**row, "opens": False, "reason": _short(error, folder)}
    for name, run in RUNS.items():
        row[name] = verdict(values, arm.path, run.overrides())
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
        "warnings": len(warnings),
        "first_warning": warnings[0] if warnings else None,
    }


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


def page(rows: Sequence[dict[str, Any]], conditions: str) -> str:
    """Return the page with the rates and a line for each file."""
    rows = [row for row in rows if not NO_ARMS.search(row["file"])]
    arms = [row for row in rows if not NO_JOINT.search(row.get("reason", ""))]
    read = [row for row in arms if row["opens"]]
    held = [row for row in read if row["load"] <= 1.0]
    lines = [
        "# Arms that were tried",
        "",
        "Arm files as their vendors and others ship them, each opened and simulated by one command"
        " without an edit.",
        "",
        "| | arms | share | goal |",
        "|---|---|---|---|",
        _rate("open", len(read), len(arms), 95),
        _rate(
            "kept without delay, of arms that have the torque",
            sum(row["no delay"] == "kept" for row in held), len(held), 98,
        ),
        _rate(
            "kept at 48 ms in a running loop, compensated, of arms that have the torque",
            sum(row["48 ms"] == "kept" for row in held), len(held), 93,
        ),
        _rate(
            "kept at 48 ms, of all that open",
            sum(row["48 ms"] == "kept" for row in read), len(read), 93,
        ),
        "",
        conditions,
        "",
        "| vendor | command | joints | mass, kg | estimated | gravity / torque | warnings |"
        " no delay | 48 ms |",
        "|---|---|---|---|---|---|---|---|---|",
        *map(_line, arms),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _rate(what: str, kept: int, of: int, goal: int) -> str:
    share = 100.0 * kept / of if of else 0.0
    aim = f"{goal} %" if share >= goal else f"{goal} %, **missed**"
    return f"| {what} | {kept} of {of} | {share:.0f} % | {aim} |"


def _line(row: dict[str, Any]) -> str:
    start = f"| {_VENDOR.sub('', row['vendor'])} | `{_cell(row['command'])}` |"
    if not row["opens"]:
        return f"{start} – | – | does not open: {_cell(row['reason'])} | – | – | – | – |"
    warned = f"{row['warnings']}: {_cell(row['first_warning'])}" if row["warnings"] else "–"
    cells = [
        row["joints"], f"{row['mass_kg']:.3g}", ", ".join(row["estimated"]) or "–",
        f"{row['load']:.2g}", warned, *(_cell(row[name]) for name in RUNS),
    ]  # fmt: skip
    return f"{start} {' | '.join(map(str, cells))} |"


def _cell(text: str) -> str:
    text = re.sub(r"(?<!\w)/\S*/", "", text)  # no folders of this machine
    return text.replace("|", "\\|")[:_REASON]


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
        given.page.write_text(page(rows, given.conditions), encoding="utf-8")


if __name__ == "__main__":
    main()
