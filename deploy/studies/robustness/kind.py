"""The kind of study `robustness`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.robustness.numbers import GaugedRobustness
from deploy.studies.robustness.page import robustness_page
from deploy.studies.robustness.robustness import Robustness

KIND = ResultKind(Robustness.kind, GaugedRobustness, Robustness, robustness_page)
