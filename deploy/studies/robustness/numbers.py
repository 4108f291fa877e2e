"""The numbers of margins over uncertain plants that a gate reads."""

from __future__ import annotations

from deploy.reports.studies.case_numbers import GaugedCase, GaugedCases


class GaugedRobustness(GaugedCases):
    """Margins over uncertain plants."""

    group = "robustness"
    key = "kept_up_to"

    def value(self, case: GaugedCase) -> float | None:
        return case.kept_up_to
