"""The kinds of result of `datasheet`: of arms, and of robots with a controller of their own."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.datasheet.result import DataSheetResult, RobotSheetResult
from deploy.studies.datasheet.results import OF_ROBOT, robot_sheet_again, sheet_again

KIND = ResultKind("datasheet", DataSheetResult, again=sheet_again)
ROBOT = ResultKind(OF_ROBOT, RobotSheetResult, again=robot_sheet_again)
