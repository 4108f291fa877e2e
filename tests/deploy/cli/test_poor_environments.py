"""Commands in odd surroundings: other encodings, broken libraries, files named like ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bus_schema.configuration import ConfigurationError
from controller.laws.custom import find_law
from tests.waiting import HANG_S
from tests.warm_process import ROOT, cold, cold_python

SHORT = ("simulate", "paper_arm", "--set", "duration_s=0.05", "--set", "metrics.from_s=0")


@pytest.mark.parametrize("words", [("--help",), SHORT, ("doctor",)], ids=lambda words: words[0])
def test_command_ends_well_where_output_has_no_room_for_its_characters(words, tmp_path):
    out = ("--out", str(tmp_path / "run")) if words == SHORT else ()
    done = cold(*words, *out, PYTHONIOENCODING="latin-1")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_pinocchio_that_cannot_be_imported_is_one_sentence_and_help_and_doctor_go_on(tmp_path):
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


@pytest.mark.parametrize(("chosen", "threads"), [("", "1"), ("3", "3")])
def test_blas_has_one_thread_unless_the_user_chooses(chosen, threads):
    """Threads of a BLAS wait for each other: a verdict took ten times the CPU time with two."""
    told = (
        "import os, sys; os.environ.pop('OPENBLAS_NUM_THREADS')\n"
        f"if '{chosen}': os.environ['OPENBLAS_NUM_THREADS'] = '{chosen}'\n"
        "import deploy.cli; assert 'numpy' not in sys.modules  # it reads this when it is loaded\n"
        "sys.argv[1:] = ['--version']\n"
        "try: deploy.cli.main()\n"
        "finally: print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    done = cold_python("-c", told)
    assert done.stdout.split()[-1] == threads, done.stderr


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


def test_law_with_the_name_of_a_product_package_is_refused_with_advice(folder):
    with pytest.raises(ConfigurationError, match="funnel-hil has a module of that name: rename"):
        find_law("controller:Law")


def test_simulation_with_closed_standard_streams_ends_with_its_own_exit_code(tmp_path):
    words = [sys.executable, "-m", "deploy.cli", *SHORT, "--out", str(tmp_path / "run")]
    closed = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(closed, env=environment, check=False, timeout=HANG_S)
    assert done.returncode == 0
    assert (tmp_path / "run" / "summary.json").is_file()


def test_terminal_of_size_zero_shows_the_same_as_one_of_unknown_size() -> None:
    assert (
        cold("scenarios", COLUMNS="0", LINES="0").stdout == cold("scenarios", COLUMNS="80").stdout
    )


def test_kernels_are_compiled_although_numba_is_disabled(tmp_path: Path) -> None:
    found = []
    for disabled in ("0", "1"):
        out = tmp_path / disabled
        done = cold(*SHORT, "--no-report", "--out", str(out), NUMBA_DISABLE_JIT=disabled)
        assert done.returncode == 0, done.stderr
        found.append(json.loads((out / "summary.json").read_text())["digest"])
    assert found[0] == found[1]
