"""`openarm_can`, unmodified, moves an emulated OpenArm over a real vcan0."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.plant_emulator.drives.test_damiao_clients import FD, START, rig_of
from tests.socketcan.openarm_package import build_openarm_can, run_client
from tests.waiting import await_true


def test_it_configures_reads_moves_and_disconnects(request: pytest.FixtureRequest) -> None:
    package = build_openarm_can(Path(request.config.cache.mkdir("wheels")))
    with rig_of(interface="socketcan", channel="vcan0", **FD) as rig:
        seen = run_client(package, "vcan0", "fd")
        np.testing.assert_allclose(seen["start"], START, atol=1e-3)
        assert seen["end"] == pytest.approx(np.asarray(seen["start"]) + 0.2, abs=0.05)
        await_true(rig.bank.braked.all)
