"""The kind of study `tune`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.tune.numbers import GaugedTuning
from deploy.studies.tune.page import tune_page
from deploy.studies.tune.tuning import Tuning

KIND = ResultKind(Tuning.kind, GaugedTuning, Tuning, tune_page)
