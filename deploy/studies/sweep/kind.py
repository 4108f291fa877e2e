"""The kind of study `sweep`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.sweep.numbers import GaugedSweep
from deploy.studies.sweep.page import sweep_page
from deploy.studies.sweep.sweep import Sweep

KIND = ResultKind(Sweep.kind, GaugedSweep, Sweep, sweep_page)
