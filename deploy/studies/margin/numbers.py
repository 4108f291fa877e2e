"""The numbers of margins that a gate reads."""

from __future__ import annotations

from deploy.reports.studies.case_numbers import GaugedCase, GaugedCases


class GaugedMargins(GaugedCases):
    """Margins of one arm."""

    group = "margin"
    key = "margin"

    def value(self, case: GaugedCase) -> float | None:
        return case.least_margin
