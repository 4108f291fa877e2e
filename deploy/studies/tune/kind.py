"""The kind of study `tune`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.tune.page import tune_page
from deploy.studies.tune.result import TuneResult
from deploy.studies.tune.tuning import Tuning

KIND = ResultKind(Tuning.kind, TuneResult, Tuning, tune_page)
