"""Margins by search, or the shares of uncertain plants: which of the two a definition asks for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.margin.margin import Margin, MarginDefinition
from deploy.studies.robustness.robustness import Robustness, RobustnessDefinition
from deploy.study.study import StudyOfRuns


def margin_study(values: Mapping[str, Any], source: Path) -> StudyOfRuns:
    """Return margins by search, or with ``plants`` the shares of uncertain plants at given values.

    Args:
        values: the definition, in the form of its YAML file.
        source: that file.

    Raises:
        ScenarioError: it cannot be used, or mixes the two.
    """
    of_many = values.get("plants") is not None
    of_search, of_plants = (set(m.model_fields) for m in (MarginDefinition, RobustnessDefinition))
    for key in sorted(
        values.keys() & (of_search - of_plants if of_many else of_plants - of_search)
    ):
        allowed = f"must be left out {'with' if of_many else 'without'} plants"
        raise ScenarioError(f"{source}: {key} = {values[key]!r}: {allowed}")
    return Robustness(values, source) if of_many else Margin(values, source)
