"""`funnel-hil view`: what it refuses, and a recording that it plays."""

from __future__ import annotations

import json
import signal

import pytest
from watched import Events, short_run

from tests.waiting import await_true
from tests.warm_process import WarmProcess


def test_a_file_that_is_no_recording_is_damaged_once(tmp_path, funnel_hil):
    (tmp_path / "run.mcap").write_text("no recording at all")
    output = funnel_hil.output("view", tmp_path, code=2)
    assert output.count("damaged") == 1
    assert "it does not begin like an MCAP file; " in output


def test_a_recording_is_played_and_its_layout_written(tmp_path):
    run = short_run()
    run.write_log(tmp_path / "run.mcap")
    viewer = WarmProcess("view", tmp_path, "--layout", tmp_path / "layout.json", "--speed", "4")
    try:
        await_true(lambda: "token=" in viewer.output() or viewer.poll() is not None)
        assert viewer.poll() is None, viewer.output()
        assert "3D!arm" in json.loads((tmp_path / "layout.json").read_text())["configById"]
        last = run.data().true_errors_rad[-1]
        events = Events(viewer.output().split()[2])
        *_, frame = events.frames()  # from the first look to the end of the recording
        assert frame["time_s"] == pytest.approx(run.setup.scenario.duration_s)
        assert viewer.poll() is None  # others may look
        assert frame["error"] == pytest.approx(1e3 * last, abs=1e-3)
        events.close()
    finally:
        viewer.send_signal(signal.SIGINT)
        assert viewer.wait() == 130, viewer.output()
