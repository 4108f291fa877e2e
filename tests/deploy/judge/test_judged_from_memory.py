"""A simulation is judged from what is in memory: its recording, read back, is the same run."""

import numpy as np
import pytest

from deploy.judge.metrics import summarise
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

IMPAIRED = ["link.uplink={delay_ms: 4, jitter_ms: 2, loss: 0.05}", "link.downlink.delay_ms=3"]
FAULT = ["faults=[{kind: encoder_stuck, joint: elbow, at_s: 0.2, for_s: 0.1}]"]


@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        ("paper_arm", []),
        ("paper_arm", ["controller.delay_compensation.enabled=true", *IMPAIRED, *FAULT]),
        ("iiwa", ["controller.law=smc"]),
        ("paper_arm_can", []),
    ],
)
def test_recording_is_what_was_in_memory(scenario, overrides, tmp_path):
    simulation = simulate(load_setup(scenario, ["duration_s=0.5", *overrides]))
    here = simulation.data(simulation.write_log(tmp_path / "run.mcap"))
    read, _ = load_run(tmp_path / "run.mcap")
    assert here.tables.keys() == read.tables.keys()
    for name, table in here.tables.items():
        assert table.dtype == read.tables[name].dtype
        assert table.tobytes() == read.tables[name].tobytes()
    assert here.events == read.events
    np.testing.assert_equal(summarise(here), summarise(read))
