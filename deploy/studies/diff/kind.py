"""The kind of result `diff`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.diff.results import diff_again
from deploy.study.comparison.recorded import KIND as NAME

KIND = ResultKind(NAME, again=diff_again)
