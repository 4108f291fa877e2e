"""Files of a user's own that are called like packages of ours are in nobody's way."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import controller
from bus_schema.configuration import ConfigurationError
from controller.laws.custom import find_law

ROOT = Path(controller.__file__).resolve().parents[1]
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
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=False)
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
