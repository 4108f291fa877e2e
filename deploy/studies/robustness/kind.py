"""The kind of study `robustness`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.robustness.page import robustness_page
from deploy.studies.robustness.result import RobustnessResult
from deploy.studies.robustness.robustness import Robustness

KIND = ResultKind(Robustness.kind, RobustnessResult, Robustness, robustness_page)
