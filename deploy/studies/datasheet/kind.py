"""The kinds of result of `datasheet`: of arms, and of robots with a controller of their own."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.datasheet.numbers import GaugedDataSheet, GaugedRobotSheet
from deploy.studies.datasheet.results import sheet_again
from deploy.studies.datasheet.robot_results import KIND as OF_ROBOT
from deploy.studies.datasheet.robot_results import robot_sheet_again

KIND = ResultKind("datasheet", GaugedDataSheet, again=sheet_again)
ROBOT = ResultKind(OF_ROBOT, GaugedRobotSheet, again=robot_sheet_again)
