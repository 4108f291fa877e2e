"""Where kernels are kept on machines that refuse the usual folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bus_schema

ROOT = Path(bus_schema.__file__).parent.parent
NO_PASSWORD_ENTRY = """
import pwd
def missing(uid):
    raise KeyError(uid)
pwd.getpwuid = missing
"""
LARGEST_FILE = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
"""
KERNEL = """
import subprocess, sys
import numpy as np
from bus_schema.runtime.compiled import all_finite
print(all_finite(np.zeros(1)), flush=True)
if len(sys.argv) == 1:
    sys.exit(subprocess.run([sys.executable, __file__, "child"]).returncode)
"""


def ran(tmp_path: Path, preamble: str = "", **environment: str | None) -> tuple[str, list[str]]:
    """What a process and its child print with these variables."""
    script = tmp_path / "script.py"
    script.write_text(preamble + KERNEL)
    temporary = tmp_path / "temporary"
    temporary.mkdir(exist_ok=True)
    inherited = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "FUNNEL_HIL_KERNELS_ARE_KEPT_ELSEWHERE")
    variables: dict[str, str | None] = {
        **os.environ, **dict.fromkeys(inherited), "PYTHONPATH": str(ROOT), "TMPDIR": str(temporary),
        **environment,
    }  # fmt: skip
    given = {name: value for name, value in variables.items() if value is not None}
    done = subprocess.run(
        [sys.executable, script], env=given, capture_output=True, text=True, check=True
    )
    return done.stdout, done.stderr.splitlines()


def kept(tmp_path: Path) -> int:
    folder = tmp_path / "temporary" / f"funnel-hil-{os.getuid()}"
    return len(list(folder.rglob("compiled.all_finite*.nbc")))


@pytest.mark.parametrize("case", ["no home", "cache is a file"])
def test_kernels_are_kept_in_a_temporary_folder_and_one_process_says_so(tmp_path, case):
    file = tmp_path / "file"
    file.touch()
    output, errors = {
        "no home": lambda: ran(tmp_path, NO_PASSWORD_ENTRY, HOME=None),
        "cache is a file": lambda: ran(tmp_path, XDG_CACHE_HOME=str(file)),
    }[case]()
    assert output == "True\nTrue\n"
    assert len(errors) == 1
    assert errors[0].startswith("compiled kernels cannot be stored in the usual folder (")
    assert kept(tmp_path) == 1


def test_a_temporary_folder_that_others_can_write_to_is_not_used(tmp_path: Path) -> None:
    folder = tmp_path / "temporary" / f"funnel-hil-{os.getuid()}"
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    output, errors = ran(tmp_path, HOME="/proc/nowhere")
    assert output == "True\nTrue\n"
    assert len(errors) == 1
    assert "every process compiles them again" in errors[0]
    assert kept(tmp_path) == 0


def test_a_kernel_that_cannot_be_written_is_used_all_the_same(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    output, errors = ran(tmp_path, LARGEST_FILE, XDG_CACHE_HOME=str(cache))
    assert output == "True\nTrue\n"
    assert [line.partition(" (")[0] for line in errors] == ["a compiled kernel cannot be stored"]


@pytest.fixture(scope="module")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with the kernel in it, made by us under umask 0."""
    folder = tmp_path_factory.mktemp("made_once")
    cache = folder / "cache"
    output, errors = ran(folder, "import os; os.umask(0)\n", XDG_CACHE_HOME=str(cache))
    assert output == "True\nTrue\n"
    assert errors == []
    return cache


@pytest.fixture
def cache(made_once: Path, tmp_path: Path) -> Path:
    """A copy of it: to compile the kernel costs more than the rest of a test."""
    return shutil.copytree(made_once, tmp_path / "cache")


def test_cache_made_under_umask_0_is_closed_to_others_and_used_again(cache, tmp_path):
    folders = [cache, cache / "funnel-hil", cache / "funnel-hil" / "numba"]
    assert [path.stat().st_mode & 0o077 for path in folders] == [0, 0, 0]
    assert ran(tmp_path, XDG_CACHE_HOME=str(cache)) == ("True\nTrue\n", [])
    assert kept(tmp_path) == 0


@pytest.mark.parametrize(
    ("by", "which"),
    [
        ("XDG_CACHE_HOME", "funnel-hil"),
        ("XDG_CACHE_HOME", "funnel-hil/numba/*"),
        ("NUMBA_CACHE_DIR", "funnel-hil"),
        ("NUMBA_CACHE_DIR", "**/*all_finite*.nbi"),
    ],
)
def test_cache_that_others_could_write_to_is_not_read(cache, tmp_path, which, by):
    for path in [cache, *cache.rglob("*")]:
        path.chmod(0o755)
    [changed] = cache.glob(which)
    changed.chmod(0o777)
    given = cache / "funnel-hil" if by == "NUMBA_CACHE_DIR" else cache
    output, errors = ran(tmp_path, **{by: str(given)})
    assert output == "True\nTrue\n"
    assert len(errors) == 1
    assert "others can write to it; remove it" in errors[0]
    assert str(changed) in errors[0]
    assert kept(tmp_path) == 1


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file to another user")
def test_cache_of_another_user_is_not_read(cache: Path, tmp_path: Path) -> None:
    [kernel] = cache.rglob("*all_finite*.nbi")
    os.chown(kernel, 12345, -1)
    _, errors = ran(tmp_path, XDG_CACHE_HOME=str(cache))
    assert len(errors) == 1
    assert "belongs to another user" in errors[0]
