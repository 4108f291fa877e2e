"""What a run leaves behind: ``run.mcap``, ``summary.json``, ``manifest.json``, ``report.html``.

And, where something went wrong, ``fault.json``.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from bus_schema.recording.atomic_files import partial_path, write_whole
from bus_schema.recording.mcap_log import LogContents, read_log
from deploy.processes.recorder import (
    DELAYS_ATTACHMENT,
    LOST_METADATA,
    ROBOT_ATTACHMENT,
    RUN_METADATA,
    SCENARIO_ATTACHMENT,
)
from deploy.runs.fault_record import fault_record
from deploy.runs.metrics import summarise
from deploy.runs.run_data import RunData, build_run_data
from deploy.scenario.link_files import DIRECTIONS
from deploy.scenario.scenario import Setup, load_setup
from deploy.scenario.scenario_text import effective_scenario, plain
from deploy.scenario.yaml_files import InputError, ScenarioError

_LIBRARIES = ("funnel-hil", "eclipse-zenoh", "pybullet", "pin", "numpy", "numba", "rosbags", "mcap")


class RunFolderError(InputError):
    """A folder holds no run that can be read."""


class RunFolder:
    """The files of one run.

    Args:
        path: the folder; created where it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.log = path / "run.mcap"
        self.can_log = path / "can.log"
        self.scenario = path / "scenario.yaml"
        self.summary = path / "summary.json"
        self.manifest = path / "manifest.json"
        self.report = path / "report.html"
        self.fault = path / "fault.json"

    @staticmethod
    def create(name: str, out: Path | None) -> RunFolder:
        """The folder for a new run, by default ``runs/<name>-<time>``.

        Raises:
            ScenarioError: it cannot be created or written to.
        """
        stamp = time.strftime("%Y%m%d-%H%M%S")
        path = (out or _unused(Path("runs") / f"{name}-{stamp}")).resolve()
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ScenarioError(f"--out {path}: cannot be created: {error.strerror}") from error
        if not os.access(path, os.W_OK):
            raise ScenarioError(f"--out {path}: is not writable")
        folder = RunFolder(path)
        judged = (folder.summary, folder.manifest, folder.report, folder.fault)
        later_logs = [*path.glob("run-*.mcap"), *path.glob("can-*.log")]  # of restarted processes
        for file in (folder.log, folder.can_log, *judged, *later_logs):
            file.unlink(missing_ok=True)
            partial_path(file).unlink(missing_ok=True)
        return folder

    def write_manifest(self, setup: Setup, grants: Mapping[str, Any]) -> None:
        """Write what was run, with what, and where; `grants`: real-time setup, by role."""
        manifest = {
            **provenance(),
            "realtime": dict(grants),
            "gains": {setup.scenario.controller.law: plain(setup.gains)},
            "scenario": plain(setup.scenario),
        }
        write_whole(self.manifest, json.dumps(manifest, indent=2) + "\n")

    def write_scenario(self, setup: Setup) -> None:
        """Write the scenario in force, with all its overrides."""
        write_whole(self.scenario, effective_scenario(setup))

    def conclude(self, run: RunData, extra_faults: Sequence[str] = ()) -> dict[str, Any]:
        """Judge a run and write summary and report; the summary.

        Args:
            run: its data.
            extra_faults: what the recording cannot know, such as a process that was killed; causes
                come before what followed from them.
        """
        summary = summarise(run)
        summary["faults"] = [*extra_faults, *summary["faults"]]
        summary["completed"] = summary["completed"] and not extra_faults
        self.write_summary(summary)
        record = fault_record(run)
        if record is not None:
            write_whole(self.fault, json.dumps(record, indent=1) + "\n")
        from deploy.reports.run_report import write_report  # figures take their time to import

        write_report(run, summary, self.report)
        return summary

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write the summary."""
        write_whole(self.summary, json.dumps(summary, indent=2) + "\n")


def load_run(path: Path) -> tuple[RunData, LogContents]:
    """Read a run folder or an MCAP file back; where that is all there is, a partial recording.

    Raises:
        RunFolderError: there is no recording of ours.
    """
    file = RunFolder(path).log if path.is_dir() else path
    if not file.exists():
        file = partial_path(file)
    if not file.is_file():
        raise RunFolderError(f"{path}: holds no run.mcap")
    contents = read_log(file)
    if not {SCENARIO_ATTACHMENT, ROBOT_ATTACHMENT} <= contents.attachments.keys():
        raise RunFolderError(f"{file}: is no recording of funnel-hil (no scenario inside)")
    with tempfile.TemporaryDirectory() as folder:
        scenario, robot = Path(folder) / SCENARIO_ATTACHMENT, Path(folder) / ROBOT_ATTACHMENT
        scenario.write_bytes(contents.attachments[SCENARIO_ATTACHMENT])
        robot.write_bytes(contents.attachments[ROBOT_ATTACHMENT])
        overrides = [f"robot.urdf={robot}"]
        for direction in DIRECTIONS:
            name = DELAYS_ATTACHMENT.format(direction=direction)
            if name in contents.attachments:
                (Path(folder) / name).write_bytes(contents.attachments[name])
                overrides.append(f"link.{direction}.distribution_file={name}")
        try:
            setup = load_setup(str(scenario), overrides)
        except ScenarioError as error:
            raise RunFolderError(f"{file}: its scenario cannot be used: {error}") from error
    run, lost = contents.metadata.get(RUN_METADATA, {}), contents.metadata.get(LOST_METADATA)
    data = build_run_data(
        setup,
        contents.payloads,
        clock=run.get("clock", "unknown"),
        link=run.get("link", "unknown"),
        lost=None if lost is None else {topic: int(count) for topic, count in lost.items()},
        complete=contents.complete,
    )
    return data, contents


def provenance() -> dict[str, Any]:
    """What was called, when, where and with which versions, for a manifest."""
    return {
        "command": sys.argv,
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "host": {
            "machine": platform.machine(),
            "kernel": platform.release(),
            "cpus": os.cpu_count(),
            "python": platform.python_version(),
        },
        "versions": {name: _version(name) for name in _LIBRARIES},
    }


def _unused(path: Path) -> Path:
    candidates: Mapping[int, Path] = {n: Path(f"{path}-{n}") for n in range(2, 1000)}
    return next((p for p in (path, *candidates.values()) if not p.exists()), path)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
