"""The kind of study `margin`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.margin.margin import Margin
from deploy.studies.margin.numbers import GaugedMargins
from deploy.studies.margin.page import margin_page

KIND = ResultKind(Margin.kind, GaugedMargins, Margin, margin_page)
