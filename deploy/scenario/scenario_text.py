"""Scenarios and gains back to plain text: what was in force, for records and reruns."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel

from deploy.scenario.scenario import Setup

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # several times as fast where it is there


def effective_scenario(setup: Setup) -> str:
    """The scenario in force as YAML: every default and override written out, paths absolute."""
    values = plain(setup.scenario)
    values["robot"]["urdf"] = str(setup.robot.path)
    return str(yaml.dump(values, Dumper=_DUMPER, sort_keys=False, allow_unicode=True))


def plain(value: Any) -> Any:
    """Models, named tuples and arrays as mappings, lists and numbers; what is None is left out."""
    match value:
        case BaseModel():
            fields = {name: getattr(value, name) for name in type(value).model_fields}
            return {name: plain(inner) for name, inner in fields.items() if inner is not None}
        case dict():
            return {name: plain(inner) for name, inner in value.items()}
        case tuple() if hasattr(value, "_asdict"):
            return {name: plain(inner) for name, inner in value._asdict().items()}
        case np.ndarray():
            return value.tolist()
        case list() | tuple():
            return [plain(inner) for inner in value]
        case _:
            return value
