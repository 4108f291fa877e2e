"""The folder of a study: one study, one command at a time."""

from __future__ import annotations

import json

import pytest
import yaml

from deploy.reports.study_report import write_study_report
from deploy.scenario.yaml_files import ScenarioError, read_yaml
from deploy.study.folder import create_folder, find_folder
from tests.deploy.study.studies import TIED, folder_of, make_sweep, margin_of


def test_an_unfinished_study_of_nothing_has_a_report(tmp_path):
    for study in (make_sweep(tmp_path, {TIED: [0, 1]}), margin_of()):
        folder = folder_of(study, tmp_path / study.kind)
        write_study_report(study.summary([]), folder)
        assert folder.report.is_file()
        assert not study.summary([])["completed"]


def test_a_folder_holds_one_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, other = make_sweep(tmp_path, {TIED: [0]}), make_sweep(tmp_path, {TIED: [1]})
    path = create_folder(one, tmp_path / "out")
    assert find_folder(one, path) == path
    with pytest.raises(ScenarioError, match=r"study\.yaml"):
        find_folder(other, path)
    assert find_folder(one, None) is None
    begun = create_folder(one, None)
    assert find_folder(one, None) == begun
    values = read_yaml(begun / "study.yaml")
    (begun / "study.yaml").write_text(yaml.safe_dump(values, sort_keys=True))
    assert find_folder(one, None) == begun  # what it says counts, not how
    (tmp_path / "runs" / "sweep-s-broken").mkdir()
    (tmp_path / "runs" / "sweep-s-broken" / "study.yaml").write_text("{")
    assert find_folder(one, None) == begun
    (begun / "summary.json").write_text(json.dumps({"completed": True}))
    assert find_folder(one, None) is None


def test_a_study_of_plants_is_found_again_whatever_is_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    draws = {"distribution": "choice", "values": [0.0, 1e-6]}
    more = {"plants": 2, "uncertainty": {"plant.encoder.resolution_rad": draws}}
    begun = create_folder(make_sweep(tmp_path, {TIED: [0]}, **more), None)
    assert find_folder(make_sweep(tmp_path, {TIED: [0]}, **more), None) == begun
    assert find_folder(make_sweep(tmp_path, {TIED: [0, 1]}, **more), begun) == begun


def test_two_commands_do_not_write_to_one_folder(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0]})
    first, second = (folder_of(sweep, tmp_path / "out") for _ in range(2))
    first.lock()
    with pytest.raises(ScenarioError, match="another command"):
        second.lock()
