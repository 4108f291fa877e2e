"""Python files in the current folder run in no process of ours; a law that was asked for does."""

import subprocess
import sys

import pytest
from warm_process import cold_python

from bus_schema.safe_path import safe_path
from deploy.run.processes import role_process

PLANTED = (
    "mujoco", "pybullet", "zenoh", "pinocchio", "numpy", "multiprocessing", "struct", "yaml",
    "json", "signal", "selectors", "can", "controller",
)  # fmt: skip
"""Names that a process would import from a folder that comes first on its path."""
AS_INSTALLED = (
    "import runpy, sys; sys.path.pop(0); sys.argv[1:] = {words};"
    "runpy.run_module('deploy.cli', run_name='__main__', alter_sys=True)"
)
SWEEP = "name: s\nscenario: paper_arm\ngrid: {plant.payload_kg: [0, 0.1]}\n"


@pytest.fixture
def planted(tmp_path, monkeypatch):
    for name in PLANTED:
        (tmp_path / f"{name}.py").write_text("open('PWNED', 'a').write(__name__)\nraise SystemExit")
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        ["doctor"],
        ["run", "paper_arm", "--set", "clock=lockstep", "--set", "duration_s=0.05"],
        [
            "simulate",
            "paper_arm",
            "--set",
            "plant.physics.engine=mujoco",
            "--set",
            "duration_s=0.02",
        ],
        ["sweep", "sweep.yaml", "--workers", "1", "--set", "duration_s=0.05"],
    ],
    ids=lambda words: words[0],
)
def test_command_imports_nothing_from_current_folder(planted, words):
    done = cold_python("-c", AS_INSTALLED.format(words=[*words]))
    assert not (planted / "PWNED").exists(), done.stderr
    assert done.returncode == 0, done.stderr


def test_doctor_of_a_rig_imports_no_law(tmp_path, funnel_hil, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planted_law.py").write_text("open('PWNED', 'w')\nclass Law: pass\n")
    (tmp_path / "rig.yaml").write_text(
        "extends: paper_arm_can\ncontroller: {law: 'planted_law:Law'}\n"
    )
    code, output = funnel_hil("doctor", "--rig", "rig.yaml")
    assert code in {0, 1}, output
    assert not (tmp_path / "PWNED").exists()
    assert "runs code of" not in output


def test_programs_of_the_user_find_their_own_modules(tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    (tmp_path / "beside.py").touch()
    (tmp_path / "program.py").write_text("import beside\n")
    role_process.prepare()
    with safe_path():
        assert subprocess.run([sys.executable, tmp_path / "program.py"], check=False).returncode
    assert not subprocess.run([sys.executable, tmp_path / "program.py"], check=False).returncode
