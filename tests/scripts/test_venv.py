"""scripts/lib/venv.sh: what an installation or a move of files leaves behind."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

VENV = Path(__file__).resolve().parents[2] / "scripts" / "lib" / "venv.sh"
SITE_PACKAGES = ".venv/lib/python3.11/site-packages"
ROOMS = ("bus_schema", "controller", "deploy", "plant_emulator", "tests")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for room in ROOMS:
        make(tmp_path / room / "__init__.py")
        make(tmp_path / room / "__pycache__" / "__init__.pyc")
    make(tmp_path / SITE_PACKAGES / "numpy" / "__pycache__" / "core.pyc")
    return tmp_path


def make(file: Path) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    return file


def remove_leftovers(tree: Path) -> None:
    command = f"set -euo pipefail; source {VENV}; remove_leftovers"
    subprocess.run(["bash", "-c", command], cwd=tree, check=True, capture_output=True)


def files_in(tree: Path) -> set[Path]:
    return set(tree.rglob("*"))


def test_caches_that_hide_the_sources_are_removed_from_the_installation(tree: Path) -> None:
    before = files_in(tree)
    make(tree / SITE_PACKAGES / "bus_schema" / "can" / "__pycache__" / "frame.pyc")
    make(tree / SITE_PACKAGES / "deploy" / "cli" / "__pycache__" / "run.pyc")
    remove_leftovers(tree)
    assert files_in(tree) == before


def test_folders_from_which_all_files_have_moved_are_removed(tree: Path) -> None:
    before = files_in(tree)
    make(tree / "bus_schema" / "msg" / "old" / "__pycache__" / "gone.pyc")
    make(tree / "tests" / "old" / "__pycache__" / "test_gone.pyc")
    remove_leftovers(tree)
    assert files_in(tree) == before


def test_folders_with_anything_else_in_them_stay(tree: Path) -> None:
    make(tree / "deploy" / "scenarios" / "mine.yaml")
    make(tree / "deploy" / "scenarios" / "__pycache__" / "gone.pyc")
    (tree / "deploy" / "empty").mkdir()
    before = files_in(tree)
    remove_leftovers(tree)
    assert files_in(tree) == before


def test_a_long_installation_is_seen_to_go_on_and_its_failure_is_its_own(tmp_path: Path) -> None:
    still = tmp_path / "still"
    command = (
        f"set -euo pipefail; source {VENV}; TOLD_EVERY_S=0.05 while_it_lasts bash -c"
        f" 'until grep -q still {still}; do :; done; exit 3' >{still}"
    )
    done = subprocess.run(["bash", "-c", command], capture_output=True, check=False, timeout=60)
    assert done.returncode == 3
    assert "still at it" in still.read_text()
