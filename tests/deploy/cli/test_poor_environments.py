"""Commands in odd surroundings: other encodings, broken libraries, files named like ours."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bus_schema.configuration import ConfigurationError
from controller.laws.custom import find_law
from tests.warm_process import ROOT, cold, cold_python

SHORT = ("simulate", "paper_arm", "--set", "duration_s=0.05", "--set", "metrics.from_s=0")


@pytest.mark.parametrize("words", [("--help",), SHORT, ("doctor",)], ids=lambda words: words[0])
def test_command_ends_well_where_output_has_no_room_for_its_characters(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    out = ("--out", str(tmp_path / "run")) if words == SHORT else ()
    done = cold(*words, *out, PYTHONIOENCODING="latin-1")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_pinocchio_that_cannot_be_imported_is_one_sentence_and_help_and_doctor_go_on(
    tmp_path: Path,
) -> None:
    (tmp_path / "pinocchio.py").write_text("raise ImportError('liburdfdom_sensor.so.4.0')\n")
    broken = {"PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = cold(*SHORT, "--out", str(tmp_path / "run"), **broken)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "pinocchio cannot be imported (liburdfdom_sensor.so.4.0): pip install" in line
    assert cold("scenarios", **broken).returncode == 0
    doctor = cold("doctor", **broken)
    assert doctor.returncode == 0
    assert "liburdfdom_sensor" in doctor.stdout


LIKE_OURS = ("bus_schema", "controller", "plant_emulator", "deploy")
RUN = (
    "import runpy, sys; sys.path.pop(0); "
    "sys.argv[1:] = ['run', '--set', 'duration_s=0.1', '--set', 'clock=lockstep', '--out', 'run'];"
    "runpy.run_module('deploy.cli', run_name='__main__', alter_sys=True)"
)
"""As the installed script does: without the current folder on its path."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in LIKE_OURS:
        (tmp_path / f"{name}.py").write_text("open('imported', 'w')\nraise RuntimeError('mine')\n")
    (tmp_path / "law_beside_them.py").write_text("class Law:\n    pass\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_run_with_files_called_like_our_packages_in_the_folder(folder):
    done = cold_python("-c", RUN)
    assert done.returncode == 0, done.stderr
    assert (folder / "run" / "summary.json").is_file()
    assert not (folder / "imported").exists()


def test_processes_that_get_our_path_find_our_packages_before_those_files(folder, monkeypatch):
    monkeypatch.setattr(sys, "path", [path for path in sys.path if Path(path or ".") != ROOT])
    assert find_law("law_beside_them:Law")
    assert sys.path.index(str(ROOT)) < sys.path.index(str(folder))
    del sys.modules["law_beside_them"]


def test_law_in_a_file_called_like_a_package_of_ours_is_told_to_be_renamed(folder):
    with pytest.raises(ConfigurationError, match="funnel-hil has a module of that name: rename"):
        find_law("controller:Law")
