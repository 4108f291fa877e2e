"""The kind of study `margin`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.margin.margin import Margin
from deploy.studies.margin.page import margin_page
from deploy.studies.margin.result import MarginResult

KIND = ResultKind(Margin.kind, MarginResult, Margin, margin_page)
