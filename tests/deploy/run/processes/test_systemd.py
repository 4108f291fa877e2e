"""systemd's own verifier on the units, as they would be installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNITS = Path(__file__).resolve().parents[4] / "deploy" / "systemd"
SYSTEM_UNITS = Path("/usr/lib/systemd/system")
ROLES = ("plant", "controller", "recorder")
HIGHEST_EXPOSURE = 2.0  # of 10; systemd calls it OK. A unit without any sandboxing has 9.6.

pytestmark = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None or not SYSTEM_UNITS.is_dir(),
    reason="systemd is not installed",
)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A system on which our units are installed beside systemd's own."""
    shutil.copytree(SYSTEM_UNITS, tmp_path / "usr/lib/systemd/system", symlinks=True)
    shutil.copytree(UNITS, tmp_path / "etc/systemd/system")
    program = tmp_path / "opt/funnel-hil/bin/funnel-hil"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    return tmp_path


def analyze(root: Path, *words: str) -> subprocess.CompletedProcess[str]:
    verb, *rest = words
    return subprocess.run(
        ["systemd-analyze", verb, f"--root={root}", *rest],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def verify(root: Path, role: str) -> tuple[int, str]:
    ended = analyze(root, "verify", "--man=no", f"funnel-hil-{role}@paper_arm.service")
    # Complaints about systemd's own units are none of ours.
    ours = [line for line in ended.stderr.splitlines() if "funnel-hil" in line]
    return ended.returncode, "\n".join(ours)


@pytest.mark.parametrize("role", ROLES)
def test_unit_is_valid(root: Path, role: str) -> None:
    assert verify(root, role) == (0, "")


@pytest.mark.parametrize("role", ROLES)
def test_unit_exposes_little(root: Path, role: str) -> None:
    unit = f"funnel-hil-{role}@paper_arm.service"
    output = analyze(root, "security", "--offline=true", unit).stdout
    (exposure,) = re.findall(r"Overall exposure level for \S+: ([\d.]+)", output)
    assert float(exposure) <= HIGHEST_EXPOSURE


@pytest.mark.parametrize("role", ROLES)
def test_service_is_given_the_keys_of_its_own_role_alone(role: str) -> None:
    text = (UNITS / f"funnel-hil-{role}@.service").read_text()
    text += (UNITS / "funnel-hil-.service.d" / "common.conf").read_text()
    given = set(re.findall(r"^LoadCredential=\S+:/etc/funnel-hil/keys/(\S+)$", text, re.MULTILINE))
    assert given == {"authority.crt", f"{role}.crt", f"{role}.key"}
