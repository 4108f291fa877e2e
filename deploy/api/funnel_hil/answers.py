"""Answers about an arm: its data sheet, and its identification from logs."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bus_schema.recording.atomic_files import write_json
from controller.laws.custom import laws_given
from deploy.judge.run_rows import Row
from deploy.reports.studies.results import write_study
from deploy.run.new_folder import new_folder
from deploy.run.run_folder import ResultFolder, provenance
from deploy.scenario.referenced_files import named_robot
from deploy.studies.datasheet.data_sheet import DataSheet
from deploy.studies.datasheet.results import sheet_folder, sheet_parts, write_data_sheet
from deploy.study.study import StudyOfRuns
from funnel_hil.results import Drawn, Study
from funnel_hil.scenarios import Changes, InputError, Law, Scenario, ScenarioLike, named_law
from funnel_hil.studies import OnProgress, session_of, written_scenarios

if TYPE_CHECKING:
    from deploy.measure.identify.identified import Identified


class Identification(Drawn):
    """An arm that was identified from logs.

    Attributes:
        summary: as in ``summary.json``.
        scenario: file of the scenario of the identified arm; None where nothing was written.
    """

    def __init__(
        self, found: Identified, summary: dict[str, Any], scenario: Path | None = None
    ) -> None:
        from deploy.studies.identify.page import PANELS  # heavy

        super().__init__(PANELS, found)
        self.summary, self.scenario, self._robot = summary, scenario, found.robot

    def __repr__(self) -> str:
        return f"<Identification of {self._robot.path.stem}>"

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self._robot.joint_names


def identify(
    logs: Sequence[str | Path],
    robot: str | Path,
    *,
    joints: Sequence[str] | None = None,
    test: Sequence[str | Path] = (),
    payload: str | Path | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    **more: Any,
) -> Identification:
    """Identify an arm from its own logs: masses, friction, rotors, delay, with intervals.

    Args:
        logs: CSV, Parquet, MCAP or rosbag2 files of one robot.
        robot: the arm's file, or the name of a shipped robot.
        joints: its driven joints; all by default.
        test: logs to test on; by default the end of each log.
        payload: log of the same arm with a payload.
        out: folder for URDF, scenario, ranges, summary and report; nothing is written without.
        overwrite: replace the results that `out` holds.
        more: what else is known: ``columns`` (of ``position``, ``velocity``, ``torque``,
            ``current``, ``command``, ``time``), ``unit``, ``degrees``, ``link_side``, ``held_out``,
            ``constants``, ``payload_kg``.

    Raises:
        InputError: a log or the arm cannot be used.
    """
    from deploy.measure.identify.identification import Wishes  # heavy
    from deploy.measure.identify.identification import identify as identify_arm
    from deploy.measure.identify.results import SCENARIO, check_is_free, summary_of, write_results
    from deploy.studies.identify.page import write_identify_report

    if unknown := more.keys() - Wishes.__dataclass_fields__.keys():
        allowed = ", ".join(Wishes.__dataclass_fields__)
        raise InputError(f"identify: {', '.join(sorted(unknown))}: must be one of {allowed}")
    arm, heavier = named_robot(str(robot), joints), None if payload is None else Path(payload)
    found = identify_arm([*map(Path, logs)], [*map(Path, test)], heavier, arm, Wishes(**more))
    if out is None:
        return Identification(found, summary_of(found, arm.path.stem))
    folder = new_folder("identify", Path(out), overwrite=overwrite)
    check_is_free(folder)
    summary = write_results(found, folder)
    write_identify_report(found, summary, folder / "report.html")
    return Identification(found, summary, folder / SCENARIO)


def datasheet(
    scenario: ScenarioLike = "paper_arm",
    changes: Changes | None = None,
    *,
    law: Law = "fixed_time_adaptive",
    network: str | Path | None = None,
    plants: int = 0,
    quick: bool = False,
    windows: int | None = None,
    workers: int | None = 0,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: OnProgress | None = None,
) -> Study:
    """Answer how much delay an arm takes: constant, varying, on a network, as uncertain plants.

    Args:
        scenario: as for `simulate`.
        changes: as for `simulate`.
        law: as for `simulate`.
        network: a file of delays, or the name of a shipped trace; None for none.
        plants: number of uncertain plants.
        quick: shorter and fewer runs.
        windows: number of windows of the network; None for 12, or 5 with `quick`.
        workers: as for `sweep`.
        scheduler: as for `sweep`.
        out: as for `sweep`.
        progress: as for `sweep`.

    Returns:
        The data sheet, with the rows of all its runs.

    Raises:
        InputError: something about it is wrong.
    """
    given, (name, makers) = Scenario(scenario, changes), named_law(law)
    with ExitStack() as stack:
        place = stack.enter_context(tempfile.TemporaryDirectory()) if out is None else out
        stack.enter_context(given.laws())
        stack.enter_context(laws_given(makers))
        (arm,) = written_scenarios([given], Path(place).resolve())
        trace = None if network is None else str(network)
        sheet = DataSheet(arm, name, trace, plants, dict(_duration(changes)), quick, windows)
        folder, rows = sheet_folder(sheet, Path(place), overwrite=False), list[Row]()

        def do(study: StudyOfRuns, part: Path) -> tuple[dict[str, Any], list[Row]]:
            with session_of(study, part, workers, scheduler, progress) as own:
                rows.extend(own.rows)
                return write_study(study, own).summary, own.rows

        parts, window = sheet_parts(sheet, sheet.margin(), sheet.windows(), folder, do)
        with ResultFolder(folder).lock() as results:
            write_json(results.manifest, provenance())
            return Study(write_data_sheet(results, sheet, parts, window), rows)


def _duration(changes: Changes | None) -> Mapping[str, Any]:
    """Return the change of the length of runs, which a data sheet otherwise chooses itself."""
    given = changes or {}
    return {"duration_s": given["duration_s"]} if "duration_s" in given else {}
