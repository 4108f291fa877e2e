"""The same bits on any CPU: its kernels of OpenBLAS and NumPy are chosen by environment."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from running import settings

from deploy.judge.arithmetic import libm_fingerprint
from tests.warm_process import ROOT, cold, cold_python

ANOTHER_LIBM = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"}


def core_types() -> list[str]:
    """Four kinds of CPU whose kernels of OpenBLAS run on this one."""
    if platform.machine() == "aarch64":
        return ["ARMV8", "CORTEXA57", "NEOVERSEN1", "THUNDERX2T99"]
    if platform.machine() != "x86_64":
        pytest.skip(f"no core types of OpenBLAS are known for {platform.machine()}")
    has_avx2, has_avx512 = (level in simd_levels() for level in ("X86_V3", "X86_V4"))
    recent = ["SkylakeX"] * has_avx512 + ["Haswell", "Sandybridge"] * has_avx2
    return [*recent, "Nehalem", "Prescott"][:4]


def simd_levels() -> list[str]:
    """What NumPy uses beyond its baseline on this CPU, the least first."""
    levels: list[str] = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    return levels


def turkish(folder: Path) -> dict[str, str]:
    """A Turkish locale: compiled here, or, without the means to, a name that is not installed."""
    name = "tr_TR.UTF-8"
    if shutil.which("localedef"):
        words = ["localedef", "-i", "tr_TR", "-f", "UTF-8", str(folder / name)]
        subprocess.run(words, capture_output=True, check=False)
    return {"LC_ALL": name, "LANG": name, "LOCPATH": str(folder)}


@pytest.fixture(scope="module")
def digests(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[str]]]:
    """Digests of all cases by environment; each is another in more than one way, to save time."""
    levels, cores = simd_levels(), core_types()
    some, every = " ".join(levels[1:]), " ".join(levels)
    environments: list[dict[str, str]] = [
        {"OPENBLAS_CORETYPE": cores[0], "PYTHONHASHSEED": "1"},
        {"OPENBLAS_CORETYPE": cores[1], "NPY_DISABLE_CPU_FEATURES": every, "PYTHONHASHSEED": "2"},
        {"OPENBLAS_CORETYPE": cores[2], **turkish(tmp_path_factory.mktemp("locale"))},
        {"OPENBLAS_CORETYPE": cores[3], "NPY_DISABLE_CPU_FEATURES": some},
    ]
    found = {}
    for number, environment in enumerate(environments):
        usable = os.sched_getaffinity(0)
        if number == 0:  # one CPU alone
            os.sched_setaffinity(0, {min(usable)})
        try:
            done = cold_python(ROOT / "tests/end_to_end/digest_cases.py", **environment)
        finally:
            os.sched_setaffinity(0, usable)
        assert done.returncode == 0, done.stderr
        found[", ".join(map("=".join, environment.items()))] = json.loads(done.stdout)
    return found


def test_every_case_has_the_same_bits_in_every_environment(digests):
    (first, expected), *others = digests.items()
    assert len(expected) >= 39
    differing = [
        f"{case}: {first} / {environment}"
        for environment, found in others
        for case in expected
        if found[case] != expected[case]
    ]
    assert not differing, "\n".join(differing)


def test_replay_and_diff_name_another_libm(tmp_path: Path) -> None:
    """As glibc has it on CPUs without AVX2 and FMA."""
    short = ["iiwa", *settings(duration_s=0.3, metrics__from_s=0), "--no-report"]
    there, here = tmp_path / "there", tmp_path / "here"
    ended = [
        cold("simulate", *short, "--out", there, **ANOTHER_LIBM),
        cold("simulate", *short, "--out", here),
    ]
    assert [each.returncode for each in ended] == [0, 0], ended
    prints = [
        json.loads((folder / "manifest.json").read_text())["arithmetic"]["libm"]
        for folder in (there, here)
    ]
    if prints[0] == prints[1]:
        pytest.skip("this C library has the same mathematics with and without FMA")
    assert prints[1] == libm_fingerprint()
    replayed = cold("replay", there)
    compared = cold("diff", there, here, "--no-report", "--out", tmp_path / "d")
    why = "The arithmetic differs (libm {} and {}), which may change the last bits."
    assert (replayed.returncode, compared.returncode) == (1, 0)
    for each in (replayed, compared):
        assert why.format(*prints) in " ".join(each.stdout.split())
    assert "arithmetic differs" not in cold("replay", here).stdout
