"""Commands on machines that lack what others have; each as a process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SHORT = ("simulate", "paper_arm", "--set", "duration_s=0.05", "--set", "metrics.from_s=0")


def funnel_hil(*words: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "deploy.cli", *words]
    return subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, check=False
    )


@pytest.mark.parametrize("words", [("--help",), SHORT, ("doctor",)], ids=lambda words: words[0])
def test_command_ends_well_where_output_has_no_room_for_its_characters(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    out = ("--out", str(tmp_path / "run")) if words == SHORT else ()
    done = funnel_hil(*words, *out, PYTHONIOENCODING="latin-1")
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr


def test_pinocchio_that_cannot_be_imported_is_one_sentence_and_help_and_doctor_go_on(
    tmp_path: Path,
) -> None:
    (tmp_path / "pinocchio.py").write_text("raise ImportError('liburdfdom_sensor.so.4.0')\n")
    broken = {"PYTHONPATH": f"{tmp_path}:{Path.cwd()}"}
    done = funnel_hil(*SHORT, "--out", str(tmp_path / "run"), **broken)
    assert done.returncode == 2
    (line,) = done.stderr.decode().splitlines()
    assert "pinocchio cannot be imported (liburdfdom_sensor.so.4.0): pip install" in line
    assert funnel_hil("scenarios", **broken).returncode == 0
    doctor = funnel_hil("doctor", **broken)
    assert doctor.returncode == 0
    assert b"liburdfdom_sensor" in doctor.stdout
