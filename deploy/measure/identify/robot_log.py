"""Reads a robot's log: times, positions, velocities and torques or currents of its joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import InputError, did_you_mean
from bus_schema.tables import column_names, read_columns
from bus_schema.time_units import UNITS_MS, units_of
from deploy.measure.recordings import opened

JOINT_STATE = "sensor_msgs/msg/JointState"
SHORTEST_S, FEWEST_ROWS = 5.0, 200
_MOSTLY = 0.9
EPISODE = "episode_index"
"""Column of LeRobot's tables, in which times begin anew with each episode."""
TIMES = ("time_s", "t", "time", "timestamp", "stamp")
PATTERNS = {
    "position": (
        "position.{joint}", "{joint}.position_rad", "{joint}.position", "q{n}_rad", "q{n}", "q_{n}",
        "actual_q_{n}", "q[{n}]", "state.q[{n}]", "position[{n}]", "observation.state[{n}]",
    ),
    "velocity": (
        "velocity.{joint}", "{joint}.velocity_rad_s", "{joint}.velocity", "dq{n}_rad_s", "dq{n}",
        "dq_{n}", "qd{n}", "actual_qd_{n}", "dq[{n}]", "state.dq[{n}]", "velocity[{n}]",
        "observation.velocity[{n}]",
    ),
    "torque": (
        "effort.{joint}", "{joint}.effort", "{joint}.torque_nm", "tau{n}_nm", "tau{n}", "tau_{n}",
        "tau_J_{n}", "tau_J[{n}]", "state.tau_J[{n}]", "effort[{n}]", "observation.effort[{n}]",
    ),
    "current": ("{joint}.current_a", "current{n}_a", "current{n}", "actual_current_{n}"),
    "command": (
        "target_q{n}_rad", "target_q_{n}", "q_d{n}", "q_d_{n}", "q_d[{n}]", "state.q_d[{n}]",
        "action[{n}]",
    ),
}  # fmt: skip
"""Names of columns, by what they hold; {n} counts joints from 0 or 1."""


@dataclass(frozen=True)
class RobotLog:
    """Content of a log, as recorded; joints in the order of the robot's file.

    Attributes:
        path: the file.
        times_s: shape (rows,).
        position: shape (rows, joints), rad.
        velocity: same shape, rad/s; None if the log has none.
        torque: same shape, N m, or A for currents.
        is_current: whether `torque` are motor currents.
        command: commanded positions, same shape; None if the log has none.
        names: name of the column of each of these values by joint, for messages.
        place: returns where a row is in the file, as ``line 12``.
        episode: number of the episode of each row, shape (rows,); None for one motion.
    """

    path: Path
    times_s: Vector
    position: Matrix
    velocity: Matrix | None
    torque: Matrix
    is_current: bool
    command: Matrix | None
    names: Mapping[str, Sequence[str]]
    place: Callable[[int], str]
    episode: Vector | None = None

    @property
    def is_long(self) -> bool:
        long = len(self.times_s) >= FEWEST_ROWS
        return long and float(np.ptp(self.times_s)) >= SHORTEST_S

    def episodes(self) -> list[RobotLog]:
        """Return a log for each episode."""
        if self.episode is None:
            return [self]
        starts = (np.flatnonzero(np.diff(self.episode)) + 1).tolist()
        return [self._part(*ends) for ends in pairwise([0, *starts, len(self.episode)])]

    def _part(self, start: int, stop: int) -> RobotLog:
        def rows(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else values[start:stop]

        return replace(
            self, times_s=self.times_s[start:stop], position=self.position[start:stop],
            velocity=rows(self.velocity), torque=self.torque[start:stop],
            command=rows(self.command), place=lambda row: self.place(start + row), episode=None,
        )  # fmt: skip

    def refusal(self, what: str, row: int | None = None) -> InputError:
        """Return the error that names file and row."""
        where = "" if row is None else f", {self.place(row)}"
        return InputError(f"{self.path}{where}: {what}")


def read_robot_log(
    path: Path, joints: Sequence[str], given: Mapping[str, str | None], unit: str | None = None
) -> RobotLog:
    """Read a log.

    Args:
        path: CSV (also gzip), Parquet, MCAP, rosbag2 (``.db3``) or a bag's folder.
        joints: the robot's joints.
        given: by keys of `PATTERNS` and ``time``: columns, separated by commas or as a pattern with
            ``{n}`` or ``{joint}``; in bags, ``position`` is the topic. None: known names.
        unit: of the times in tables, if the name of their column does not say it; else seconds.

    Raises:
        InputError: it cannot be read, or lacks values; the message names file, column and line.
    """
    if path.is_dir() or path.suffix in (".mcap", ".db3"):
        if unit is not None:
            raise InputError(f"{path}: --unit must be left out: bags have stamps")
        return _from_bag(_bag_in(path), joints, given.get("position"))
    try:
        names = column_names(path)
        wanted = {kind: _chosen(kind, given.get(kind), names, joints) for kind in PATTERNS}
        time = given.get("time") or next((each for each in TIMES if each in names), TIMES[0])
        if not (wanted["position"] and (wanted["torque"] or wanted["current"])):
            kind = "position" if not wanted["position"] else "torque"
            example = ", ".join(p.format(joint=joints[0], n=1) for p in PATTERNS[kind][:6])
            raise ValueError(
                f"{path}: has no {kind} of each of the {len(joints)} joints {', '.join(joints)}"
                f"{_nearly(kind, names, joints)};"
                f" known names are {example}, …, and --{kind} names others. Columns are"
                f" {', '.join(names[:60])}"
            )
        also = [EPISODE] if EPISODE in names else []
        every = [time, *(c for each in wanted.values() for c in each), *also]
        found = read_columns(path, every, None)
        times_s = found.values[time] * (
            UNITS_MS[units_of([time], unit, f"{path}: --unit")[time]] / 1e3
        )
    except ValueError as error:
        raise InputError(str(error)) from error

    def matrix(kind: str) -> Matrix | None:
        return np.column_stack([found.values[c] for c in wanted[kind]]) if wanted[kind] else None

    position, torque = matrix("position"), matrix("torque")
    is_current = given.get("current") is not None or torque is None
    torque = matrix("current") if is_current else torque
    assert position is not None and torque is not None  # noqa: PT018 (checked above)

    return RobotLog(
        path, times_s, position, matrix("velocity"), torque, is_current, matrix("command"),
        {**wanted, "time": [time]}, found.place, found.values.get(EPISODE),
    )  # fmt: skip


def _chosen(kind: str, given: str | None, names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return the columns of one kind, one per joint; none if the file has none of that kind.

    Raises:
        ValueError: a column that the user names is missing.
    """
    for pattern in PATTERNS[kind] if given is None else (given,):
        for first in (0, 1):
            columns = [
                pattern.replace("{joint}", joint).replace("{n}", str(number))
                for number, joint in enumerate(joints, first)
            ] if "{" in pattern else [each.strip() for each in pattern.split(",")]  # fmt: skip
            if len(columns) == 1 < len(joints) and f"{columns[0]}[0]" in names:
                columns = [f"{columns[0]}[{index}]" for index in range(len(joints))]
            if len(set(columns)) == len(joints) and set(columns) <= set(names):
                return columns
    if given is None:
        return []
    missing = next((each for each in columns if each not in names), "")
    what = f"column {missing} is missing{did_you_mean(missing, names)}"
    if len(set(columns)) < len(columns):
        what = "names a column twice; a pattern may contain {n} or {joint}"
    elif not missing:
        what = f"names {len(columns)} columns, the robot has {len(joints)} joints"
    raise ValueError(f"--{kind} {given}: {what}")


def _nearly(kind: str, names: Sequence[str], joints: Sequence[str]) -> str:
    """Return which columns are missing of a pattern that fits more than one joint."""
    for pattern in PATTERNS[kind]:
        wanted = [pattern.replace("{joint}", each) for each in joints]
        lacking = [each for each in wanted if each not in names]
        if len(lacking) < len(wanted) - 1:
            return f": {', '.join(lacking)} {'is' if len(lacking) == 1 else 'are'} missing"
    return ""


def _bag_in(path: Path) -> Path:
    """Return the recording in a folder that is no rosbag2, as that of a run.

    Raises:
        InputError: there is none, or there are several.
    """
    if path.is_file() or (path / "metadata.yaml").is_file():
        return path
    files = [each for each in path.iterdir() if each.suffix in (".mcap", ".db3")]
    if len(files) != 1:
        raise InputError(
            f"{path}: has no metadata.yaml of rosbag2, and {len(files)} MCAP or .db3 files: name"
            " a bag's folder or a file"
        )
    return files[0]


def _from_bag(path: Path, joints: Sequence[str], topic: str | None) -> RobotLog:
    """Read messages of type JointState from one topic, by the stamps in their headers."""
    found, others = _joint_states(path, joints, topic or JOINT_STATE)
    whole = {
        name: rows
        for name, rows in found.items()
        if any(np.isfinite(values[[0, 2]]).all() for _, _, values in rows)
    }
    if len(whole) != 1:
        what = f"{', '.join(whole)}: --position must name one of these topics"
        if not whole:
            named = "; ".join(f"{name} has {', '.join(each)}" for name, each in others.items())
            what = f"no {topic or JOINT_STATE} with position and effort of {', '.join(joints)}"
            what = f"{what}; {named}" if named else what
        raise InputError(f"{path}: {what}")
    ((name, rows),) = whole.items()
    rows.sort(key=lambda row: row[0])
    stamps_ns, every = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
    has_velocity = bool(np.isfinite(every[:, 1]).mean() > _MOSTLY)
    return RobotLog(
        path, (np.array(stamps_ns) - stamps_ns[0]) * 1e-9, every[:, 0],
        every[:, 1] if has_velocity else None, every[:, 2], is_current=False, command=None,
        names={kind: [f"{name}.{kind}[{j}]" for j in joints] for kind in ("position", "velocity",
                                                                         "torque")},
        place=lambda row: f"message {row + 1} on {name}",
    )  # fmt: skip


_JointStates = dict[str, list[tuple[int, int, Matrix]]]
"""By topic: time of recording, stamp, and position, velocity and effort, shape (3, joints)."""


def _joint_states(
    path: Path, joints: Sequence[str], wanted: str
) -> tuple[_JointStates, dict[str, Sequence[str]]]:
    """Return the joint states on each topic, and the names on topics that lack a joint."""
    found: _JointStates = {}
    others: dict[str, Sequence[str]] = {}
    with opened(path) as recording:
        for message in recording.messages(wanted):
            try:
                state = message.content
                if set(joints) <= set(state.name):
                    row = (message.logged_ns, *_stamped(state, joints))
                    found.setdefault(message.topic, []).append(row)
                else:
                    others[message.topic] = state.name
            except MemoryError:
                raise
            except Exception as error:  # rosbags raises many kinds of errors
                what = f"a message on {message.topic} is no {JOINT_STATE}: {error}"
                raise InputError(f"{path}: {what}") from error
    return found, others


def _stamped(state: Any, joints: Sequence[str]) -> tuple[int, Matrix]:
    """Return the stamp of a JointState, and its position, velocity and effort."""
    stamp_ns = state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec
    values = [_by_name(state, kind, joints) for kind in ("position", "velocity", "effort")]
    return stamp_ns, np.array(values)


def _by_name(state: Any, kind: str, joints: Sequence[str]) -> Vector:
    """Return the values of joints in a JointState; NaN if it has none of this kind."""
    values, names = np.asarray(getattr(state, kind), float), list(state.name)
    if len(values) != len(names):
        return np.full(len(joints), np.nan)
    return np.asarray(values[[names.index(name) for name in joints]])
