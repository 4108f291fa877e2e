"""Files of runs: ``run.mcap``, ``summary.json``, ``manifest.json``, ``report.html``.

After a fault also ``fault.json``.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import sys
import tempfile
import time
import weakref
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from bus_schema.configuration import shown
from bus_schema.errors import InputError
from bus_schema.recording.atomic_files import partial_path, write_json
from bus_schema.recording.mcap_log import LogContents, read_log
from bus_schema.registry import extensions_in
from bus_schema.user_files import read_text
from controller.laws.custom import custom_laws_left_out
from deploy.judge.arithmetic import libm_fingerprint
from deploy.judge.run_data import RunData, build_run_data
from deploy.judge.tested_with import TESTED_WITH, tested_with
from deploy.run.new_folder import FolderLock, missing_recording, new_folder
from deploy.run.recording import (
    DAMAGING,
    FAILURES_METADATA,
    LOST_METADATA,
    RECORDER_METADATA,
    REJECTED_METADATA,
    ROBOT_ATTACHMENT,
    RUN_METADATA,
    SCENARIO_ATTACHMENT,
)
from deploy.scenario.checking.warnings import all_warnings
from deploy.scenario.effective import write_scenario
from deploy.scenario.referenced_files import DATA_FILES
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, plain

_LIBRARIES = (
    "funnel-hil", "eclipse-zenoh", "pybullet", "mujoco", "pin", "numpy", "numba", "rosbags", "mcap",
)  # fmt: skip


_MOST_DIGITS = 19


class RunFolderError(InputError):
    """A folder holds no readable results of ours."""


class ResultFolder:
    """Folder of a command's results: numbers, provenance and a report.

    Args:
        path: the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary = path / "summary.json"
        self.manifest = path / "manifest.json"
        self.report = path / "report.html"
        self._lock: FolderLock | None = None

    def lock(self) -> Self:
        """Keep other commands from writing here while the context lasts.

        Raises:
            ScenarioError: another command is writing.
        """
        self._lock = FolderLock(self.path)
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Let others write here again."""
        if self._lock is not None:
            self._lock.close()


class RunFolder(ResultFolder):
    """The files of one run."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.log = path / "run.mcap"
        self.can_log = path / "can.log"
        self.scenario = path / "scenario.yaml"
        self.fault = path / "fault.json"

    @staticmethod
    def begin(setup: Setup, out: Path | None, *, overwrite: bool = False) -> RunFolder:
        """Create and lock the folder of a new run, with the scenario in force and a manifest.

        Raises:
            ScenarioError: as for `new_folder`.
        """
        folder = RunFolder(new_folder(setup.scenario.name, out, overwrite=overwrite))
        folder.lock()
        folder.write_scenario(setup)
        folder.write_manifest(setup, {})
        return folder

    def write_scenario(self, setup: Setup) -> None:
        """Write the scenario in force; after a run, without the endpoints that only this run had.

        So it can be run again, also at the same time as others.
        """
        write_scenario(setup, self.scenario)

    def write_manifest(
        self, setup: Setup, grants: Mapping[str, Any], real_delay: Mapping[str, Any] | None = None
    ) -> None:
        """Write the manifest: what was run, how it was tested, with what, and where.

        Args:
            setup: the scenario, whose recording has the arm in other words.
            grants: real-time setup, by role.
            real_delay: a real delay of the link, and how exactly it was kept; None for none.
        """
        delay = {} if real_delay is None else {"real_delay": dict(real_delay)}
        tested = tested_with([setup], {"seeds": [setup.scenario.seed]})
        write_json(self.manifest, manifest_of([setup], grants) | delay | {TESTED_WITH: tested})


def read_summary(path: Path) -> dict[str, Any]:
    """Return the content of a folder's ``summary.json``; empty if there is none."""
    return read_json(path / "summary.json")


def _failures(path: Path, contents: LogContents) -> list[str]:
    """Return what ended processes of a run; for older recordings only the folder contains it."""
    if FAILURES_METADATA in contents.metadata:
        return list(contents.metadata[FAILURES_METADATA].values())
    listed = read_summary(path).get("unrecorded_faults")
    return [each for each in listed if isinstance(each, str)] if isinstance(listed, list) else []


def read_manifest(path: Path) -> dict[str, Any]:
    """Return the content of a folder's ``manifest.json``; empty if there is none."""
    return read_json(path / "manifest.json")


def read_json(file: Path) -> dict[str, Any]:
    """Return the content of a JSON file; empty if it is missing or holds no mapping."""
    try:
        values = json.loads(read_text(file))
    except (OSError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def load_run(path: Path, setup: Setup | None = None) -> tuple[RunData, LogContents]:
    """Read a run folder or an MCAP file; a partial recording only if there is no other.

    The recording is untrusted: a law in its scenario that is not shipped is not imported, and does
    nothing in the setup.

    Args:
        path: the folder or file.
        setup: judges the run instead of the scenario in its recording.

    Raises:
        RunFolderError: there is no recording of ours.
    """
    file = RunFolder(path).log if path.is_dir() else path
    if not file.exists():
        file = partial_path(file)
    if not file.is_file():
        raise RunFolderError(missing_recording(path, str(read_summary(path).get("kind", ""))))
    contents = read_log(file)
    damage = f"; it is damaged: {'; '.join(contents.damage)}" if contents.damage else ""
    if not {SCENARIO_ATTACHMENT, ROBOT_ATTACHMENT} <= contents.attachments.keys():
        raise RunFolderError(
            f"{file}: is not a recording of funnel-hil (it contains no scenario and arm){damage}"
        )
    try:
        setup = setup or _setup_in(contents)
    except ScenarioError as error:
        said = error.lines(f"{file}: its scenario cannot be used: ", damage)
        raise RunFolderError(*said) from error
    run = contents.metadata.get(RUN_METADATA, {})
    lost, rejected = _counts(contents, LOST_METADATA), _counts(contents, REJECTED_METADATA) or {}
    data = build_run_data(
        setup,
        contents.payloads,
        clock=run.get("clock", "unknown"),
        link=run.get("link", "unknown"),
        lost=lost,
        complete=contents.complete,
        damage=[*contents.damage, *_miscounted(contents), *_forgeries(rejected)],
        rejected=rejected,
        failures=_failures(path if path.is_dir() else path.parent, contents),
        lacks_checksums=contents.lacks_checksums,
    )
    return data, contents


def _forgeries(rejected: Mapping[str, int]) -> list[str]:
    """Explain in a sentence why it is uncertain which messages are the plant's."""
    found = ", ".join(f"{name}: {rejected[name]}" for name in DAMAGING if rejected.get(name))
    return [f"another sender used the plant's name ({found})"] if found else []


def _setup_in(contents: LogContents) -> Setup:
    """Load the scenario in a recording; its files exist as long as the setup is in use.

    Raises:
        ScenarioError: it cannot be used.
    """
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for name in {SCENARIO_ATTACHMENT, ROBOT_ATTACHMENT, *DATA_FILES.values()}:
            if name in contents.attachments:
                (folder / name).write_bytes(contents.attachments[name])
        files = {"robot.urdf": ROBOT_ATTACHMENT, **DATA_FILES}
        overrides = [
            f"{key}={folder / name}" for key, name in files.items() if name in contents.attachments
        ]
        with custom_laws_left_out():
            setup = load_setup(str(folder / SCENARIO_ATTACHMENT), overrides)
        weakref.finalize(setup, stack.pop_all().close)
    return setup


def _miscounted(contents: LogContents) -> list[str]:
    """Explain in a sentence that messages were added or taken away after the recording."""
    read, written = sum(map(len, contents.payloads.values())), _counts(contents, RECORDER_METADATA)
    if not contents.complete or not written or read == written.get("messages"):
        return []
    return [f"it has {read} messages, but its recorder wrote {written.get('messages')}"]


def _counts(contents: LogContents, name: str) -> dict[str, int] | None:
    """Return a recording's table of counts; None if it is missing or invalid, which is damage."""
    table = contents.metadata.get(name)
    for key, count in (table or {}).items():
        if not (count.isdecimal() and len(count) < _MOST_DIGITS):
            allowed = f"must be a whole number of at most {_MOST_DIGITS - 1} digits"
            contents.damage.append(f"its metadata {name}: {key[:40]} = {shown(count)}: {allowed}")
            return None
    return None if table is None else {key: int(count) for key, count in table.items()}


def manifest_of(
    setups: Sequence[Setup], grants: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Return the manifest: what is run, with what, and where.

    Args:
        setups: the scenario, with each of its laws.
        grants: real-time setup, by role.
    """
    scenario = plain(setups[0].scenario)
    used = {each for setup in setups for each in extensions_in(plain(setup.scenario))}
    return {
        **provenance(),
        **({"extensions": sorted(map(str, used))} if used else {}),
        "realtime": dict(grants),
        "warnings": all_warnings(setups),
        "set": [text for text in setups[0].overrides if all(text in s.overrides for s in setups)],
        "gains": {setup.scenario.controller.name: plain(setup.gains) for setup in setups},
        "scenario": scenario,
    }


def provenance() -> dict[str, Any]:
    """Return command, time, machine and versions, for a manifest."""
    return {
        "command": sys.argv,
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "host": {
            "machine": platform.machine(),
            "kernel": platform.release(),
            "cpus": os.cpu_count(),
            "usable_cpus": len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else None,
            "python": platform.python_version(),
        },
        "versions": {name: _version(name) for name in _LIBRARIES},
        "arithmetic": {"libm": libm_fingerprint()},
    }


def grown_from(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest of extended results, which includes the manifest before.

    Args:
        before: the manifest of the existing results.
        now: the manifest of the added ones.
    """
    earlier = {key: value for key, value in before.items() if key != "grown_from"}
    return {**now, "grown_from": [*before.get("grown_from", []), earlier]}


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
