"""Identity of a study in its folder: kind, definition, and digests of its scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deploy.scenario.effective import effective_scenario
from deploy.scenario.referenced_files import data_files
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, read_yaml, to_yaml
from deploy.scenario.yaml_text import values_of
from deploy.study.execution.growth import changes
from deploy.study.study import StudyOfRuns, digest_of

STUDY_FILE = "study.yaml"


def changes_since(study: StudyOfRuns, path: Path) -> list[str]:
    """Return which scenarios and files of a folder's study have changed, a sentence each."""
    return changes(read_yaml(path / STUDY_FILE), identity_of(study), digests_of(study))


def identity_of(study: StudyOfRuns) -> dict[str, Any]:
    """Return a study's identity, in the form of ``study.yaml``: equal ones request equal rows."""
    values = {
        "kind": study.kind,
        "definition": study.definition.model_dump(by_alias=True),
        "scenario_digests": {base.scenario.name: _digest(base) for base in study.bases},
        **({"file_digests": dict(study.files)} if study.files else {}),
    }
    given_back: dict[str, Any] = values_of(to_yaml(values))  # a tuple is a list there
    return given_back


def has_definition(path: Path, wanted: dict[str, Any]) -> bool:
    """Whether a folder holds a study of this kind and definition."""
    try:
        found = read_yaml(path / STUDY_FILE)
    except ScenarioError:
        return False
    return all(found.get(key) == wanted[key] for key in ("kind", "definition"))


def digests_of(study: StudyOfRuns) -> set[tuple[str, str]]:
    """Return names and digests of the scenarios in every setting."""
    return {(setup.scenario.name, _digest(setup)) for setup in study.variants}


def _digest(setup: Setup) -> str:
    files = [file.read_bytes() for file in data_files(setup.scenario).values()]
    return digest_of(effective_scenario(setup).encode(), setup.robot.text.encode(), *files)
