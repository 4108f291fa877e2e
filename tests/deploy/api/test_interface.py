"""The Python interface gives what the commands give, for scenarios and laws in any form."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import plotly.graph_objects as go
import pytest
import yaml

import funnel_hil
from controller.control_law import Diagnostics
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import SHIPPED, load_setup

SHORT = {"duration_s": 0.2}
WALL = ("real_time_factor", "timing")
"""Of a summary, what is measured in wall time."""


class ComputedTorque:
    def __init__(self, model, stiffness=400.0):
        self.diagnostics = Diagnostics(model.joints)
        self.model, self.stiffness, self.calls = model, stiffness, 0

    def reset(self):
        self.calls = 0

    def torque(self, tracking):
        self.calls += 1
        damping = 2.0 * self.stiffness**0.5
        wanted = tracking.reference_acceleration - self.stiffness * tracking.error
        wanted = wanted - damping * tracking.error_rate
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, wanted)


@pytest.fixture(scope="module")
def run():
    return funnel_hil.simulate("paper_arm", SHORT)


def digest(run):
    return run.summary["digest"]


def test_run_is_that_of_the_command(run):
    data = simulate(load_setup("paper_arm", ["duration_s=0.2"])).data()
    assert {key: value for key, value in run.summary.items() if key not in WALL} == {
        key: value for key, value in summarise(data).items() if key not in WALL
    }
    assert run.kept
    assert run.margin == run.summary["bounds"]["margin_min"]
    np.testing.assert_array_equal(run.errors_rad, data.true_errors_rad)
    assert run.times_s.shape == (201,)
    assert run.torques_nm.shape == run.errors_rad.shape == (run.summary["ticks"] + 1, 3)


@pytest.mark.parametrize("form", ["mapping", "extended", "sections", "arrays", "file", "scenario"])
def test_scenario_in_any_form_gives_the_same_bits(run, form, tmp_path):
    whole = yaml.safe_load((SHIPPED / "paper_arm.yaml").read_text())
    file = tmp_path / "mine.yaml"
    offset = np.array(whole["robot"]["initial_offset_rad"])
    given = {
        "mapping": lambda: (whole, SHORT),
        "extended": lambda: ({"extends": "paper_arm", **SHORT}, None),
        "sections": lambda: ("paper_arm", {**SHORT, "link": {"uplink": {"loss": 0.0}}}),
        "arrays": lambda: (
            "paper_arm", {"duration_s": np.float64(0.2), "robot": {"initial_offset_rad": offset}}
        ),
        "file": lambda: (file.write_text(yaml.dump(whole)) and file, SHORT),
        "scenario": lambda: (funnel_hil.Scenario("paper_arm", {"duration_s": 1}), SHORT),
    }  # fmt: skip
    assert digest(funnel_hil.simulate(*given[form]())) == digest(run)
    assert whole == yaml.safe_load((SHIPPED / "paper_arm.yaml").read_text())


def test_law_as_class_object_or_function_gives_the_same_bits():
    class_, function = ComputedTorque, lambda model: ComputedTorque(model)
    law = ComputedTorque(funnel_hil.Scenario().setup.scenario.controller.nominal_model(
        funnel_hil.Scenario().setup.robot
    ))  # fmt: skip
    runs = [funnel_hil.simulate("paper_arm", SHORT, law=each) for each in (class_, law, function)]
    assert len({digest(run) for run in runs}) == 1
    assert runs[0].faults == []
    assert runs[0].law.endswith(":ComputedTorque")
    assert law.calls == 0  # runs have copies
    gains = {**SHORT, "controller.gains.custom": {"stiffness": 100.0}}
    assert digest(funnel_hil.simulate("paper_arm", gains, law=class_)) != digest(runs[0])


def test_law_that_raises_is_a_fault_of_the_run():
    class Raising(ComputedTorque):
        def torque(self, tracking):
            raise ValueError("no more")

    run = funnel_hil.simulate("paper_arm", SHORT, law=Raising)
    assert not run.kept
    assert "no more" in run.faults[0]


def test_comparison_and_its_folder(tmp_path):
    laws = ["pid", ComputedTorque]
    compared = funnel_hil.compare("paper_arm", SHORT, laws=laws)
    written = funnel_hil.compare("paper_arm", SHORT, laws=laws, out=tmp_path / "both")
    name = list(compared.runs)[1]
    assert [row["law"] for row in compared.rows] == ["pid", name]
    assert [digest(one) for one in written.runs.values()] == [
        digest(one) for one in compared.runs.values()
    ]
    assert (tmp_path / "both" / "report.html").is_file()
    assert isinstance(compared.figure("errors"), go.Figure)
    assert digest(funnel_hil.load_run(tmp_path / "both" / "pid")) == digest(compared["pid"])
    assert [each.path for each in compared.runs.values()] == [None, None]
    assert written["pid"].path == tmp_path / "both" / "pid"
    assert [digest(funnel_hil.load_run(each.path)) for each in written.runs.values()] == [
        digest(each) for each in compared.runs.values()
    ]
    beside = funnel_hil.diff(*written.runs.values())
    assert [each.path for each in beside.runs.values()] == [
        each.path for each in written.runs.values()
    ]


def test_runs_that_were_written_or_loaded_are_compared(run, tmp_path):
    for delay_ms in (1, 2):
        path, changes = tmp_path / str(delay_ms), {**SHORT, "link.uplink.delay_ms": delay_ms}
        written = funnel_hil.simulate("paper_arm", changes, out=path)
    compared = funnel_hil.diff(funnel_hil.load_run(tmp_path / "1"), written)
    assert list(compared.runs) == ["1", "2"]
    assert digest(compared["2"]) == digest(written)
    assert compared.differing == {"link.uplink.delay_ms": ["1.0", "2.0"]}
    with pytest.raises(funnel_hil.InputError, match="must be a folder, an MCAP file, or a run"):
        funnel_hil.diff(written, run)


def test_sweep_is_that_of_single_runs_and_goes_on_in_its_folder(tmp_path):
    key = "controller.model_scale"  # by which gains are derived anew at every point
    grid, reported = {key: [0.8, 1.0]}, []
    changes = {**SHORT, "controller.gains": {}}
    swept = funnel_hil.sweep(
        "iiwa", grid, changes, out=tmp_path / "s", progress=lambda *counts: reported.append(counts)
    )
    alone = [funnel_hil.simulate("iiwa", {**changes, key: scale}) for scale in (0.8, 1.0)]
    assert [row["digest"] for row in swept.rows] == [digest(run) for run in alone]
    assert reported == [(1, 2), (2, 2)]
    assert isinstance(swept.figure("curve-violation_fraction"), go.Figure)
    again = funnel_hil.sweep("iiwa", grid, changes, out=tmp_path / "s")
    assert again.rows == swept.rows
    with pytest.raises(
        funnel_hil.InputError, match="has another study, which this one does not extend"
    ):
        funnel_hil.sweep("iiwa", {key: [0.9]}, changes, out=tmp_path / "s")


def test_margin_of_a_law_given_as_a_class():
    found = funnel_hil.margin(
        "paper_arm", SHORT, laws=[ComputedTorque, "pid"], seeds=1, offsets=[1.0], resolution=8.0,
        limit=32.0,
    )  # fmt: skip
    assert {row["law"] for row in found.rows} == set(found.margins)
    assert all(row["error"] is None for row in found.rows)


def test_series_are_columns_and_data_frames(run):
    columns = run.series()
    np.testing.assert_array_equal(columns["error.elbow"], run.errors_rad[:, 2])
    inside = (columns["error.elbow"] < columns["upper_bound.elbow"]) & (
        columns["error.elbow"] > columns["lower_bound.elbow"]
    )
    assert inside.all()
    reference = columns["position.elbow"] - columns["error.elbow"]
    np.testing.assert_allclose(columns["reference.elbow"], reference)
    assert all(len(set(map(len, run.series(name).values()))) == 1 for name in run.series_names)
    pandas = pytest.importorskip("pandas")
    frame = run.frame("joint_commands")
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame) == ["effort.base_yaw", "effort.shoulder", "effort.elbow"]
    assert frame.index.name == "time_s"


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: funnel_hil.simulate("nowhere"), "nowhere: no such file, nor one of the shipped"),
        (lambda: funnel_hil.simulate(changes={"duration": 3}), "did you mean duration_s"),
        (lambda: funnel_hil.simulate({"name": "x"}), "scenario: duration_s: is missing"),
        (lambda: funnel_hil.simulate(law=3), "law = 3: must be a name, a class, or an object"),
        (lambda: funnel_hil.simulate(law="pdi"), "controller.law = 'pdi': must be one of"),
        (lambda: funnel_hil.compare(laws=["pid", "pid"]), "laws: must have different names"),
        (lambda: funnel_hil.sweep(grid={"seed": [1]}), "must be given under seeds"),
        (lambda: funnel_hil.margin(quantity="haste"), "quantity = 'haste'"),
        (lambda: funnel_hil.load_run("nowhere"), "nowhere: has no run.mcap"),
        (lambda: funnel_hil.diff(3, 4), "diff: 3: must be a folder, an MCAP file, or a run"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_with_key_and_value(ask, message):
    with pytest.raises(funnel_hil.InputError, match=message):
        ask()


@pytest.mark.parametrize("imports", ["controller, funnel_hil", "funnel_hil, controller"])
def test_module_with_the_name_of_a_product_package_is_refused_with_advice(tmp_path, imports):
    (tmp_path / "controller.py").touch()
    done = subprocess.run(
        [sys.executable, "-c", f"import {imports}"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert f"ImportError: {tmp_path}/controller.py has the name of a package" in done.stderr
    assert done.stderr.endswith("rename it, for instance to my_controller.py\n")


def test_folder_named_like_a_package_of_ours_is_no_module(tmp_path):
    (tmp_path / "controller").mkdir()
    words = [sys.executable, "-c", "import funnel_hil; funnel_hil.scenarios()"]
    assert subprocess.run(words, cwd=tmp_path, check=False).returncode == 0


def test_mypy_of_a_script_elsewhere_knows_the_types(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import funnel_hil\nfrom funnel_hil import Diagnostics\n\n"
        "reveal_type(funnel_hil.simulate('paper_arm').margin)\n"
        "reveal_type(Diagnostics(3).network_output)\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "mine.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert 'Revealed type is "float | None"' in done.stdout
    assert "numpy.float64" in done.stdout
