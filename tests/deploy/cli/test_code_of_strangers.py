"""Commands that look at files of a stranger's run nothing of them; those that run say what."""

import os
import shutil
import sys
from pathlib import Path

import pytest

import funnel_hil as api
from deploy.cli import view

TOUCH = "open('PWNED', 'w').close()\n"
EXPLOIT = (
    "${(lambda: [c for c in ().__class__.__base__.__subclasses__()"
    " if c.__name__=='_wrap_close'][0].__init__.__globals__['system']('touch PWNED') or 1)()}"
)
XACRO = f"""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="base"/><link name="arm"><inertial><mass value="{EXPLOIT}"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/>
  <limit lower="-1" upper="1" effort="5" velocity="5"/></joint></robot>"""
PLACES = {
    "law": "controller: {law: 'planted:Law'}\n",
    "external": "controller: {law: external, external: {command: [./program]}}\n",
    "process": "clock: lockstep\ncontroller: {process: [./program]}\n",
    "xacro": "robot: {urdf: arm.xacro}\n",
}
COMMANDS = {
    "report of a run": ["report", "run"],
    "report of a comparison": ["report", "comparison"],
    "report of a sweep": ["report", "sweep"],
    "view": ["view", "run", "--port", "0", "--foxglove-port", "0"],
    "diff": ["diff", "run", "run2"],
    "export": ["export", "run", "--out", "tables"],
    "runs": ["runs", "list", "."],
    "reference": ["reference", "given.yaml", "--out", "reference.csv"],
    "ros2-control": ["ros2-control", "given.yaml", "--out", "ros"],
    "robot": ["robot", "arm.xacro"],
}


@pytest.fixture(scope="module")
def results(tmp_path_factory, funnel_hil):
    """A run, a comparison and a sweep of a scenario with nothing foreign in it."""
    folder = tmp_path_factory.mktemp("results")
    given, sweep = folder / "given.yaml", folder / "sweep.yaml"
    given.write_text("extends: paper_arm\nduration_s: 0.02\n")
    sweep.write_text(f"name: s\nscenario: {given}\ngrid: {{plant.payload_kg: [0, 0.1]}}\n")
    for words in (
        ["simulate", given, "--no-report", "--out", folder / "run"],
        ["compare", given, "--laws", "pid", "--out", folder / "comparison"],
        ["sweep", sweep, "--workers", "1", "--out", folder / "sweep"],
    ):
        funnel_hil.output(*words)
    return folder


@pytest.fixture(params=["law", "external", "xacro"])
def planted(request, results, tmp_path, monkeypatch):
    """The same with foreign code in all scenarios that lie there, and where imports look."""
    folder = tmp_path / "planted"
    shutil.copytree(results, folder)
    monkeypatch.chdir(folder)
    (folder / "arm.xacro").write_text(XACRO)
    (folder / "planted.py").write_text(TOUCH + "class Law: pass\n")
    (folder / "program").write_text(f"#!{sys.executable}\n{TOUCH}")
    (folder / "program").chmod(0o755)
    text = f"extends: paper_arm\nduration_s: 0.02\n{PLACES[request.param]}"
    for file in [folder / "given.yaml", *folder.rglob("scenario.yaml")]:
        file.write_text(text)
    shutil.copy(folder / "arm.xacro", folder / "run")
    study = folder / "sweep" / "study.yaml"
    study.write_text(study.read_text().replace(str(results), str(folder)))
    shutil.copytree(folder / "run", folder / "run2")
    sys.modules.pop("planted", None)
    return folder


def test_commands_that_look_run_nothing(planted, funnel_hil, monkeypatch):
    def not_waiting(viewer, source, *_):
        source.close()
        viewer.close()

    monkeypatch.setattr(view, "_serve", not_waiting)
    monkeypatch.setattr(view, "_AWAIT_RECORDER_S", 0.1)
    priority = os.getpriority(os.PRIO_PROCESS, 0)
    for name, words in COMMANDS.items():
        if name == "view":
            (planted / "run" / "run.mcap").rename(planted / "run.mcap")
        code, output = funnel_hil(*words)
        if name == "view":
            (planted / "run.mcap").rename(planted / "run" / "run.mcap")
        assert code in {0, 1, 2}, output
        assert not Path("PWNED").exists(), name
    assert os.getpriority(os.PRIO_PROCESS, 0) == priority  # or all later tests would be slower
    assert api.load_run(planted / "run").kept is not None
    assert not Path("PWNED").exists()


@pytest.mark.parametrize(
    ("place", "message"),
    [("law", "law planted:Law"), ("external", "program ./program"), ("process", "program ./")],
)
def test_commands_that_run_say_first_whose_code(tmp_path, funnel_hil, monkeypatch, place, message):
    monkeypatch.chdir(tmp_path)
    scenario = tmp_path / "given.yaml"
    scenario.write_text(f"extends: paper_arm\nduration_s: 0.02\n{PLACES[place]}")
    _, text = funnel_hil("simulate", scenario)
    lines = text.splitlines()
    assert lines[0].startswith(f"runs code of {scenario}: {message}")
    assert len([line for line in lines if line.startswith("runs code of")]) == 1
