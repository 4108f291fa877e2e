"""Sweeps and margins: what is asked for, in whatever order workers deliver it."""

from __future__ import annotations

import json
import random
import threading
from pathlib import Path

import pytest
import yaml

from controller.laws import LAWS
from deploy.experiments.margin import Margin, MarginDefinition
from deploy.experiments.simulate import simulate
from deploy.experiments.study import carry_out, execute, retrace
from deploy.experiments.study_definition import find_study, read_definition
from deploy.experiments.study_folder import StudyFolder, create_folder, find_folder, study_text
from deploy.experiments.study_report import write_study_report
from deploy.experiments.study_text import margin_table
from deploy.experiments.sweep import Sweep, SweepDefinition, load_sweep
from deploy.scenario import load_setup
from deploy.yaml_files import ScenarioError

TIED = "link.uplink.delay_ms, link.downlink.delay_ms"


class Here:
    """Workers that do a run when asked for one, in an order of their own."""

    count = 2

    def __init__(self, do=execute, seed=0, at_most=None):
        self._do, self._waiting, self._random = do, [], random.Random(seed)
        self.submitted, self.stop, self._at_most = [], threading.Event(), at_most

    def submit(self, run):
        self.submitted.append(run)
        self._waiting.append(run)

    def finished(self, _timeout_s):
        run = self._waiting.pop(self._random.randrange(len(self._waiting)))
        if self._at_most is not None and len(self.submitted) - len(self._waiting) >= self._at_most:
            self.stop.set()
        return run, self._do(run)


class Silent:
    def done(self, *_, **__):
        pass


def made_up(run, **values):
    """A row without a simulation."""
    fraction = values.pop("violation_fraction", 0.0)
    return {
        "point": run.point, **run.columns, "scenario": "made_up", "law": "pid", "seed": run.seed,
        "completed": True, "error": None, "bounds_kept": fraction == 0.0,
        "violation_fraction": fraction, "margin_min": 0.5, "rms_rad": [1e-3, 2e-3, 1e-3],
        "total_variation_nm_per_s": [1.0, 1.0, 1.0], "joint_names": ["a", "b", "c"], **values,
    }  # fmt: skip


def sweep_of(grid, **more):
    return {"name": "s", "scenario": "paper_arm", "grid": grid, **more}


def make_sweep(tmp_path, grid, **more):
    return Sweep(SweepDefinition.model_validate(sweep_of(grid, **more)), tmp_path, "s.yaml")


def folder_of(study, path):
    path.mkdir(exist_ok=True)
    return StudyFolder(path, study.kind, study.columns, study.seeds[0])


def conduct(study, path, workers):
    folder = folder_of(study, path)
    whole = carry_out(study, workers, folder, Silent(), workers.stop)
    folder.put_together()
    return whole, folder


def test_a_grid_is_every_combination_with_every_seed(tmp_path):
    grid = {TIED: {"from": 0, "to": 1, "step": 0.5}, "controller.law": ["pid", "smc"]}
    sweep = make_sweep(tmp_path, grid, seeds=[4, 9])
    runs = list(sweep.first())
    assert len(runs) == sweep.expected == 3 * 2 * 2
    assert len({run.key for run in runs}) == 12
    last = load_setup(runs[-1].scenario, runs[-1].overrides).scenario
    assert (last.link.uplink.delay_ms, last.link.downlink.delay_ms) == (1.0, 1.0)
    assert last.controller.law == "smc"
    assert [run.seed for run in runs[:2]] == [4, 9]


def test_ranges_include_both_ends_and_do_not_drift(tmp_path):
    sweep = make_sweep(tmp_path, {"link.uplink.delay_ms": {"from": 0, "to": 0.3, "step": 0.1}})
    assert list(sweep.axes.values()) == [[0.0, 0.1, 0.2, 0.3]]


def test_values_of_any_type_are_swept(tmp_path):
    grid = {
        "robot.initial_offset_rad": [[0.1, 0.0, 0.0], 0.05],
        "plant.friction.enabled": [True, False],
    }
    sweep = make_sweep(tmp_path, grid)
    assert sweep.columns == {
        "robot.initial_offset_rad": "string",
        "plant.friction.enabled": "bool",
    }
    first = next(iter(sweep.first()))
    assert load_setup(first.scenario, first.overrides).start_position_rad.shape == (3,)


def test_a_row_of_a_sweep_is_what_simulate_gives(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [1]}, set={"duration_s": 0.2}, seeds=[3])
    (run,) = sweep.first()
    setup = load_setup(
        "paper_arm",
        ["duration_s=0.2", "seed=3", "link.uplink.delay_ms=1", "link.downlink.delay_ms=1"],
    )
    assert execute(run)["digest"] == simulate(setup).data().digest


def test_rows_do_not_depend_on_order_nor_on_interruptions(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0, 1, 2]}, seeds=4)
    whole, _ = conduct(sweep, tmp_path / "a", Here(made_up, seed=1))
    assert whole
    workers = Here(made_up, seed=2, at_most=5)
    whole, folder = conduct(sweep, tmp_path / "b", workers)
    assert not whole
    assert len(folder.rows) == 5
    workers = Here(made_up, seed=3)
    whole, folder = conduct(sweep, tmp_path / "b", workers)
    assert whole
    assert len(workers.submitted) == 12 - 5
    rows = [(tmp_path / name / "sweep.parquet").read_bytes() for name in "ab"]
    assert rows[0] == rows[1]
    assert not (tmp_path / "b" / "rows").exists()


def test_rows_are_safe_before_they_are_put_together(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0, 1]}, seeds=2)
    folder = folder_of(sweep, tmp_path / "out")
    runs = list(sweep.first())
    for run in runs[:2]:
        folder.add(run, made_up(run))
        folder.flush()
    (tmp_path / "out" / "rows" / "000003.unfinished").write_bytes(b"cut off by a kill")
    again = folder_of(sweep, tmp_path / "out")
    assert [again.find(run) is not None for run in runs] == [True, True, False, False]


def test_every_point_has_its_scenario(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0, 1.5]}, seeds=[7, 8])
    _, folder = conduct(sweep, tmp_path / "out", Here(made_up))
    assert sorted(file.name for file in folder.scenarios.iterdir()) == ["00000.yaml", "00001.yaml"]
    command = folder.rerun_command("00001")
    again = load_setup(command.removeprefix("funnel-hil simulate "))
    assert again.scenario.link.uplink.delay_ms == 1.5
    assert again.scenario.seed == 7


def test_a_run_that_fails_is_a_row_and_not_the_end(tmp_path):
    sweep = make_sweep(tmp_path, {"duration_s": [0.1, 0.2]})
    first, _ = sweep.first()
    missing = execute(type(first)(first.point, "gone.yaml", (), 1, first.columns))
    assert "gone.yaml" in missing["error"]
    workers = Here(lambda run: missing if run == first else made_up(run))
    whole, folder = conduct(sweep, tmp_path / "out", workers)
    assert whole
    assert [row["error"] is None for row in folder.rows] == [False, True]
    summary = sweep.summary(folder.rows)
    assert summary["completed"]
    assert summary["runs_failed"] == 1


IMPOSSIBLE = [
    ({"link.uplink.delay": [1]}, {}, ["link.uplink.delay", "there is no such key"]),
    ({"link.uplink.delay_ms": [1, -1]}, {}, ["link.uplink.delay_ms", "-1", "greater than or eq"]),
    ({"controller.law": ["pid", "magic"]}, {}, ["controller.law", "'magic'", *LAWS]),
    ({TIED: []}, {}, [TIED, "[]", "a list of values"]),
    ({TIED: [1, 1]}, {}, [TIED, "different values"]),
    ({TIED: {"from": 0, "to": 1, "step": 0}}, {}, [TIED, "a step above 0"]),
    ({TIED: {"from": 0, "to": 1}}, {}, [TIED, "{from, to, step}"]),
    ({"seed": [1]}, {}, ["seed", "under seeds"]),
    ({TIED: [1]}, {"set": {"link.uplink.delay_ms": 1}}, ["link.uplink.delay_ms", "once"]),
    ({TIED: [1]}, {"seeds": 0}, ["seeds", "0", "from 1"]),
    ({TIED: [1]}, {"seeds": [1, 1]}, ["seeds", "different"]),
    ({TIED: [1]}, {"scenario": "no_arm"}, ["no_arm", "paper_arm"]),
    ({TIED: [1]}, {"grids": {}}, ["grids", "no such key"]),
]


@pytest.mark.parametrize(("grid", "more", "said"), IMPOSSIBLE)
def test_impossible_sweeps_are_refused_with_the_reason(funnel_hil, tmp_path, grid, more, said):
    file = tmp_path / "bad.yaml"
    file.write_text(yaml.safe_dump(sweep_of(grid, **more)))
    code, output = funnel_hil("sweep", file, "--out", tmp_path / "out")
    assert code == 2
    assert output.startswith(f"error: {file}")
    assert [word for word in said if word not in output] == []
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--laws", "pid,magic"], ["'magic'", "smc"]),
        (["--quantity", "colour"], ["quantity", "'colour'", "'delay', 'jitter' or 'loss'"]),
        (["--seeds", "0"], ["seeds", "0", "from 1"]),
        (["--offsets", "1,1"], ["offsets", "different"]),
        (["--offsets", "x"], ["offsets", "'x'", "number"]),
        (["--offsets", "20"], ["robot.initial_offset_rad"]),
        (["--duration", "-1"], ["duration_s", "-1", "greater than 0"]),
        (["--compensation", "maybe"], ["compensation", "'maybe'"]),
        (["--set", "link.nonsense=1"], ["link.nonsense", "no such key"]),
        (["--study", "none"], ["none", "shipped studies", "delay_margin"]),
        (["--workers", "1", "--scheduler", "tcp://127.0.0.1:1"], ["--workers", "--scheduler"]),
        (["--workers", "0"], ["--workers"]),
    ],
)
def test_impossible_margins_are_refused_with_the_reason(funnel_hil, tmp_path, words, said):
    code, output = funnel_hil("margin", *words, "--out", tmp_path / "out")
    assert code == 2
    assert [word for word in said if word not in output] == []
    assert not (tmp_path / "out").exists()


def margin_of(**values):
    given = {"laws": ["pid", "smc"], "seeds": 2, "limit": 16, **values}
    return Margin(MarginDefinition.model_validate(given), Path(), "margin")


def limits(run):
    """PID holds to 3 ms, SMC to 9.5 ms, but only to 7 ms from the second start."""
    smc = any("smc" in override for override in run.overrides)
    limit = 3.0 if not smc else 9.5 if run.columns["offset_scale"] == 1.0 else 7.0
    over = max(0.0, run.columns["value"] - limit)
    return made_up(run, violation_fraction=over / 100)


def test_margins_are_those_of_the_worst_start_and_seed(tmp_path):
    margin = margin_of()
    whole, folder = conduct(margin, tmp_path / "out", Here(limits, seed=5))
    assert whole
    summary = margin.summary(folder.rows)
    assert [case["margin"] for case in summary["cases"]] == [3.0, 7.0]
    assert [case["first_failure"] for case in summary["cases"]] == [3.5, 7.5]
    assert margin.expected == len(folder.rows)
    probe = next(probe for probe in summary["cases"][1]["probes"] if probe["value"] == 8.0)
    assert not probe["held"]
    # Of the 4 runs at 8 ms, the two from the second start are outside at 1 % of their ticks.
    assert probe["violation_fraction"] == {"mean": 0.005, "lowest": 0.0, "highest": 0.01}
    assert (probe["runs"], probe["runs_kept"]) == (4, 2)


def test_half_of_a_round_trip_goes_each_way():
    run = next(iter(margin_of(limit=12, resolution=12).first()))
    point = Margin._overrides(margin_of(), margin_of().cases[0], 12.0, 1.0)
    link = load_setup(run.scenario, point).scenario.link
    assert (link.uplink.delay_ms, link.downlink.delay_ms) == (6.0, 6.0)


def test_a_search_goes_on_where_it_stopped(tmp_path):
    _, folder = conduct(margin_of(), tmp_path / "a", Here(limits, seed=1))
    workers = Here(limits, seed=2, at_most=17)
    assert not conduct(margin_of(), tmp_path / "b", workers)[0]
    workers = Here(limits, seed=3)
    assert conduct(margin_of(), tmp_path / "b", workers)[0]
    assert len(workers.submitted) == len(folder.rows) - 17
    rows = [(tmp_path / name / "margin.parquet").read_bytes() for name in "ab"]
    assert rows[0] == rows[1]
    again = margin_of()
    retrace(again, folder_of(again, tmp_path / "b"))
    assert [search.margin for search in again.searches] == [6, 14]


def test_a_run_that_fails_does_not_hold(tmp_path):
    margin = margin_of(laws=["pid"])
    broken = Here(lambda run: made_up(run, error="it broke" if run.columns["value"] > 2 else None))
    _, folder = conduct(margin, tmp_path / "out", broken)
    assert margin.summary(folder.rows)["cases"][0]["margin"] == 2.0


def test_margins_as_a_table_for_documents(tmp_path):
    margin = margin_of(limit=8)
    _, folder = conduct(margin, tmp_path / "out", Here(lambda run: made_up(run) | {
        "bounds_kept": "pid" not in str(run.overrides)}))  # fmt: skip
    assert margin_table(margin.summary(folder.rows)).splitlines() == [
        "| law | paper_arm |",
        "| --- | --- |",
        "| `pid` | none |",
        "| `smc` | ≥ 8 ms |",
    ]


@pytest.mark.parametrize(
    "grid",
    [
        {},
        {"controller.law": ["pid", "smc"]},
        {TIED: [0, 1, 2], "controller.model_scale": [0.9, 1.0], "controller.law": ["pid", "smc"]},
    ],
)
def test_every_sweep_has_a_report_that_names_reruns(tmp_path, grid):
    sweep = make_sweep(tmp_path, grid, seeds=2)
    _, folder = conduct(sweep, tmp_path / "out", Here(made_up))
    write_study_report(sweep.summary(folder.rows), folder)
    page = folder.report.read_text(encoding="utf-8")
    assert 'href="scenarios/00000.yaml"' in page
    assert f"funnel-hil simulate {tmp_path / 'out' / 'scenarios' / '00000'}.yaml" in page
    assert ('id="curve-violation_fraction"' in page) == bool(grid)
    assert page.count('<figure class="card" id="field-worst_rms_rad-') == 2 * (len(grid) == 3)


def test_margins_have_a_report_with_bars_and_curves(tmp_path):
    margin = margin_of()
    _, folder = conduct(margin, tmp_path / "out", Here(limits))
    write_study_report(margin.summary(folder.rows), folder)
    page = folder.report.read_text(encoding="utf-8")
    for name in ("margins", "outside", "rms"):
        assert f'id="{name}-paper_arm"' in page


def test_an_unfinished_study_of_nothing_has_a_report(tmp_path):
    for study in (make_sweep(tmp_path, {TIED: [0, 1]}), margin_of()):
        folder = folder_of(study, tmp_path / study.kind)
        write_study_report(study.summary([]), folder)
        assert folder.report.is_file()
        assert not study.summary([])["completed"]


def test_a_folder_holds_one_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, other = (
        study_text("sweep", sweep.definition_values(), sweep.bases)
        for sweep in (make_sweep(tmp_path, {TIED: [0]}), make_sweep(tmp_path, {TIED: [1]}))
    )
    path = create_folder("sweep", "s", tmp_path / "out", one)
    assert find_folder("sweep", "s", path, one) == path
    with pytest.raises(ScenarioError, match=r"study\.yaml"):
        find_folder("sweep", "s", path, other)
    assert find_folder("sweep", "s", None, one) is None
    begun = create_folder("sweep", "s", None, one)
    assert find_folder("sweep", "s", None, one) == begun
    (begun / "summary.json").write_text(json.dumps({"completed": True}))
    assert find_folder("sweep", "s", None, one) is None


def test_two_commands_do_not_write_to_one_folder(tmp_path):
    sweep = make_sweep(tmp_path, {TIED: [0]})
    first, second = (folder_of(sweep, tmp_path / "out") for _ in range(2))
    first.lock()
    with pytest.raises(ScenarioError, match="another command"):
        second.lock()


def test_report_judges_the_rows_of_a_study_again(funnel_hil, tmp_path):
    margin = margin_of()
    text = study_text("margin", margin.definition_values(), margin.bases)
    path = create_folder("margin", "m", tmp_path / "out", text)
    conduct(margin, path, Here(limits))
    code, output = funnel_hil("report", path)
    assert code == 0
    assert "7 ms" in output
    assert json.loads((path / "summary.json").read_text())["cases"][0]["margin"] == 3.0
    assert "| `smc` | 7 ms |" in (path / "table.md").read_text()


def test_the_shipped_study_asks_for_all_laws_on_both_arms_with_and_without_compensation():
    definition = read_definition(find_study("delay_margin"), MarginDefinition)
    assert definition.laws == list(LAWS)
    assert definition.scenarios == ["paper_arm", "iiwa"]
    assert definition.compensation == [False, True]


def test_the_shipped_sweep_can_be_run():
    assert load_sweep("delay_sweep").expected == 11 * 5 * 2
