"""The kind of study `sweep`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.sweep.page import sweep_page
from deploy.studies.sweep.result import SweepResult
from deploy.studies.sweep.sweep import Sweep

KIND = ResultKind(Sweep.kind, SweepResult, Sweep, sweep_page)
