"""Fewer runs decide the same: the worst go first, and what decides depends on no worker."""

from __future__ import annotations

import pytest

from deploy.scenario.yaml_files import ScenarioError, read_yaml, to_yaml
from deploy.study.execution.folder import create_folder, find_folder
from tests.deploy.study.studies import NOISE, Here, conduct, folder_of, limits, made_up, margin_of
from tests.deploy.study.test_robustness import heavy_ones_lost, robustness_of


class Crowd(Here):
    """Workers that have room for many runs at a time."""

    count = 16


def outcome(study, folder):
    summary = study.summary(folder.rows)
    return [(case["margin"], case["first_failure"]) for case in summary["cases"]]


def test_margins_are_the_same_with_fewer_runs(tmp_path):
    few, all_runs = margin_of(), margin_of(exhaustive=True)
    found = [conduct(study, tmp_path / str(number), Here(limits))[1]
             for number, study in enumerate((few, all_runs))]  # fmt: skip
    assert outcome(few, found[0]) == outcome(all_runs, found[1]) == [(3.0, 3.5), (7.0, 7.5)]
    assert len(found[0].rows) < len(found[1].rows) == few.summary([])["saved"]["runs_planned"]


def test_a_value_is_lost_at_the_first_loss_and_the_worst_start_and_seed_go_first(tmp_path):
    def second_start_with_seed_2_loses_most(run):
        worse = (run.columns["offset_scale"] != 1.0) + (run.seed == 2)
        over = run.columns["value"] - (10.0 - worse)
        return made_up(run, violation_fraction=max(0.0, over)) | {"margin_min": -over}

    margin = margin_of(laws=["pid"])
    worker = Here(second_start_with_seed_2_loses_most)
    worker.count = 0  # nothing ahead of its request
    conduct(margin, tmp_path / "out", worker)
    assert margin.searches[0].margin == 16  # 8 ms
    lost = [run for run in worker.submitted if run.columns["value"] > 8.0]
    assert {(run.columns["offset_scale"], run.seed) for run in lost} == {(-0.5, 2)}
    assert len(lost) == len({run.columns["value"] for run in lost})


@pytest.mark.parametrize("study", [margin_of, lambda: robustness_of(seeds=2, set=NOISE)])
def test_the_table_does_not_depend_on_the_number_of_workers(study, tmp_path):
    do = limits if study is margin_of else heavy_ones_lost
    for name, worker in (("one", Here(do)), ("many", Crowd(do, seed=4))):
        worked = study()
        conduct(worked, tmp_path / name, worker)
        assert worked.expected == worked.summary([])["runs"] + len(worker_rows(worked))
    assert len(worker.submitted) > len(worker_rows(worked))  # some ahead, for nothing
    tables = [(tmp_path / name / f"{worked.kind}.parquet").read_bytes() for name in ("one", "many")]
    assert tables[0] == tables[1]
    names = [{file.name for file in (tmp_path / name / "scenarios").iterdir()}
             for name in ("one", "many")]  # fmt: skip
    assert names[0] == names[1]


def worker_rows(study):
    return [row for trial in study.all_trials for row in trial.rows]


def test_idle_workers_work_ahead(tmp_path):
    worker = Crowd(made_up)
    study = robustness_of(values=[8])
    runs = list(study.first())
    assert len(runs) == 1
    assert len(list(study.ahead())) == 19
    conduct(robustness_of(values=[8]), tmp_path / "out", worker)
    assert len({run.key for run in worker.submitted}) == len(worker.submitted)


def test_shares_are_decided_by_the_first_plants_and_say_how_surely(tmp_path):
    study = robustness_of(plants=60)
    conduct(study, tmp_path / "out", Here(heavy_ones_lost))
    summary = study.summary(folder_of(study, tmp_path / "out").rows)
    first, second, _ = summary["cases"][0]["values"]
    assert (first["kept"], first["total"], first["tolerated"]) == (27, 27, True)
    assert first["interval_95"] == pytest.approx([0.025 ** (1 / 27), 1.0])
    assert second["tolerated"] is False
    assert second["total"] < 10
    assert summary["cases"][0]["kept_up_to"] == 8
    assert summary["test"]["passes_at_poor_share"] == pytest.approx(0.068, abs=1e-3)
    numbers = [trial.known.judged for trial in study.all_trials]
    for judged in numbers:
        assert [run.columns["plant"] for run, _ in judged] == list(range(1, len(judged) + 1))


def test_a_study_of_all_runs_does_not_continue_one_of_the_deciding_runs(tmp_path):
    path = create_folder(margin_of(), tmp_path / "out")
    with pytest.raises(ScenarioError, match="exhaustive = True: must be False"):
        find_folder(margin_of(exhaustive=True), path)
    assert find_folder(margin_of(), path) == path


def test_a_study_of_an_older_version_continues_only_with_all_runs(tmp_path):
    path = create_folder(margin_of(exhaustive=True), tmp_path / "out")
    older = read_yaml(path / "study.yaml")
    del older["definition"]["exhaustive"]
    (path / "study.yaml").write_text(to_yaml(older))
    assert find_folder(margin_of(exhaustive=True), path) == path
    with pytest.raises(ScenarioError, match="exhaustive = False: must be True"):
        find_folder(margin_of(), path)


def test_other_physics_get_all_runs():
    assert margin_of(confirm=True).definition.is_exhaustive
    assert not any(run.ends_early for run in margin_of(confirm=True).first())
    assert all(run.ends_early for run in margin_of().first())
