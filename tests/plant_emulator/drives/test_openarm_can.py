"""`openarm_can`, unmodified, moves an emulated OpenArm; its CAN sockets are UNIX sockets here.

On a real vcan0 it runs in `tests/socketcan`.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.plant_emulator.drives.test_damiao_clients import FD, START, rig_of
from tests.socketcan.openarm_package import build_openarm_can, run_client
from tests.socketcan.unix_bridge import program_on_bus
from tests.waiting import await_true


@pytest.fixture(scope="module")
def package(request: pytest.FixtureRequest) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    return build_openarm_can(request.config.cache.mkdir("wheels"))


@pytest.mark.parametrize(("frames", "given"), [("fd", FD), ("classical", {})])
def test_it_configures_reads_moves_and_disconnects(package, tmp_path, frames, given):
    with rig_of(**given) as rig, program_on_bus(rig.channel, tmp_path) as variables:
        seen = run_client(package, "can0", frames, **variables)
        assert seen["CTRL_MODE"] == [1.0] * 7
        assert seen["TMAX"] == [54.0, 54.0, 28.0, 28.0, 10.0, 10.0, 10.0]
        np.testing.assert_allclose(seen["start"], START, atol=1e-3)
        assert seen["end"] == pytest.approx(np.asarray(seen["start"]) + 0.2, abs=0.05)
        await_true(lambda: all("DISABLED" in each for each in rig.bank.statuses))
    assert rig.bank.rejections.counts == {}


def test_missing_fd_flag_shows_as_motors_that_give_no_values(package: Path, tmp_path: Path) -> None:
    with rig_of() as rig, program_on_bus(rig.channel, tmp_path) as variables:
        seen = run_client(package, "can0", "fd", patience_s=1.0, **variables)
        assert seen == {"CTRL_MODE": None}
        assert set(rig.bank.rejections.counts) == {"no_classical_frame"}
