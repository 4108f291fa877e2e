"""Under what conditions the rows of a study came about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deploy.runs.conditions import (
    Conditions,
    host_of,
    physics_of,
    provenance_of,
    set_text,
    warnings_of,
)
from deploy.scenario.yaml_files import override
from deploy.study.study import Study

_LAW = "controller.law"


def conditions_of_study(
    study: Study, summary: Mapping[str, Any], manifest: Mapping[str, Any]
) -> Conditions:
    """What its tables, figures and rows are to be quoted with.

    Args:
        study: the study.
        summary: what it says of its rows.
        manifest: ``manifest.json`` of its folder.
    """
    fixed = study.definition.fixed
    durations = {base.scenario.name: f"{base.scenario.duration_s:g} s" for base in study.bases}
    return {
        **provenance_of(manifest),
        "study": " ".join(dict.fromkeys([summary["kind"], summary["name"]])),
        "scenario": ", ".join(durations),
        "law": ", ".join(_laws(study, summary)),
        "physics": physics_of(study.bases),
        "quantity": _quantity(summary),
        "duration": ", ".join(f"{name} {duration}" for name, duration in durations.items()),
        "starts": _starts(summary),
        "seeds": ", ".join(map(str, summary["seeds"])),
        "set": set_text([override(key, value) for key, value in fixed.items()]),
        **host_of(manifest),
        **warnings_of(manifest),
    }


def _laws(study: Study, summary: Mapping[str, Any]) -> list[str]:
    """All laws that have a case, or that a grid or the scenario names."""
    cases = [case["law"] for case in summary.get("cases", ())]
    swept = [
        law for axis in summary.get("axes", ()) if _LAW in axis["keys"] for law in axis["values"]
    ]
    own = [base.scenario.controller.name for base in study.bases]
    return list(dict.fromkeys(cases or swept or own))


def _quantity(summary: Mapping[str, Any]) -> str:
    """What is varied, with its unit, and how finely."""
    if "axes" in summary:
        return "; ".join(
            f"{', '.join(axis['keys'])} = {', '.join(map(_value_text, axis['values']))}"
            for axis in summary["axes"]
        )
    text = f"{summary['title']} ({summary['unit'] or 'no unit'})"
    if "values" in summary:
        return f"{text} at {', '.join(f'{value:g}' for value in summary['values'])}"
    return f"{text} up to {summary['limit']:g}, found to within {summary['resolution']:g}"


def _value_text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _starts(summary: Mapping[str, Any]) -> str:
    offsets = summary.get("offsets", [1.0])
    text = "initial offset × " + ", ".join(f"{offset:g}" for offset in offsets)
    if summary.get("plants") is None:
        return text
    return f"{text}; {summary['plants']} plants of plant_seed {summary['plant_seed']}"
