"""Laws of a user's own go with the runs of a study: workers need none of their files."""

from __future__ import annotations

import sys

import pytest

from deploy.study.execution.dask_workers import packed, row_with
from deploy.study.planned_run import PlannedRun, row_of

SOURCE = """
import numpy as np
from controller.control_law import Diagnostics

STIFFNESS = 400.0

def wanted(tracking):
    return tracking.reference_acceleration - STIFFNESS * tracking.error

class Own:
    def __init__(self, model):
        self.diagnostics, self.model = Diagnostics(model.joints), model
    def reset(self):
        pass
    def torque(self, tracking):
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, wanted(tracking))
"""
LAW = "law_of_the_user:Own"
RUN = PlannedRun("0", "paper_arm", (f"controller.law={LAW}", "duration_s=0.1"), 1, {})


@pytest.fixture
def law_file(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    file = tmp_path / "law_of_the_user.py"
    file.write_text(SOURCE)
    yield file
    sys.modules.pop("law_of_the_user", None)


def test_law_runs_where_its_file_is_not(law_file):
    there = row_of(RUN)
    laws = packed([LAW, "pid"])
    assert list(laws) == [LAW]
    law_file.unlink()
    del sys.modules["law_of_the_user"]
    assert "cannot be imported" in row_of(RUN)["error"]
    shipped = row_with(RUN, laws)
    assert shipped["error"] is None
    assert shipped["digest"] == there["digest"]
    assert "law_of_the_user" not in sys.modules


def test_law_that_cannot_be_packed_is_left_to_the_workers_own_files(law_file):
    law_file.write_text(SOURCE + "\n    __reduce_ex__ = None\nimport sys\nOwn.file = sys.stdout\n")
    assert packed([LAW]) == {}


def test_law_that_cannot_be_unpacked_is_an_error_of_the_run():
    row = row_with(RUN, {LAW: b"nothing of the kind"})
    assert row["error"].startswith("UnpicklingError")
    assert row["point"] == "0"
