"""The instant that all figures of a run's report share, the arm that moves, and the page's size."""

from __future__ import annotations

import base64
import json
import re
import zlib
from itertools import product

import numpy as np
import plotly.graph_objects as go
import pytest
from plotly.offline import get_plotlyjs

from controller.manipulator_model import ManipulatorModel
from controller.reference import sample_positions
from deploy.judge.run_data import build_run_data
from deploy.reports.figures.space import arm_motion, tip_path
from deploy.reports.figures.style import figure_json
from deploy.reports.html import LIBRARY_FILE, library_address, share_library, write_page
from deploy.reports.runs.run_pages import run_page
from deploy.reports.runs.run_panels import RUN_PANELS
from deploy.run.execute import JudgedRun
from deploy.run.new_folder import new_folder
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.studies.comparison.page import laws_page
from deploy.study.comparison.compared_runs import ComparedRuns

MOST_BYTES = 5_000_000


def floats(packed):
    assert packed["dtype"] == "f4"
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4")


@pytest.fixture(scope="module")
def run():
    return simulate(load_setup("iiwa", ["duration_s=2", "metrics.from_s=0.5"])).data()


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("alone") / "report.html"
    write_page(path, run_page(JudgedRun("", run)))
    return path.read_text(encoding="utf-8")


def test_the_arm_in_the_page_is_where_it_was_and_where_it_was_to_be(run, page):
    shown = re.search(r'data-motion="arm-motion-plot">(.*?)</script>', page)
    frames = json.loads(shown[1])
    times_s = floats(frames["times"])
    points = floats(frames["points"])
    points = points.reshape(len(times_s), frames["traces"], frames["points_of_each"], 3)
    assert len(times_s) <= 400
    assert (times_s[0], times_s[-1]) == pytest.approx((0.0, 2.0))
    model, truth = ManipulatorModel(run.setup.robot), run.tables["plant_truth"]
    wanted = sample_positions(run.setup.reference, times_s.astype(float), run.setup.robot.joints)
    for frame in (0, len(times_s) // 2, len(times_s) - 1):
        position = truth["position"][round(float(times_s[frame]) * 1000)]
        for trace, posture in enumerate((wanted[frame], position)):
            bones = points[frame, trace].reshape(-1, 3, 3)
            assert np.isnan(bones[:, 2]).all()  # each bone is a line of its own
            np.testing.assert_allclose(bones[:, :2], model.skeleton(posture), atol=1e-6)
            np.testing.assert_allclose(bones[-1, 1], model.tip_position(posture), atol=1e-6)


def test_a_skeleton_hangs_together(run):
    bones = ManipulatorModel(run.setup.robot).skeleton(run.setup.start_position_rad)
    assert len(bones) == run.setup.robot.joints + 1
    assert not bones[0, 0].any()  # it stands on the base
    np.testing.assert_array_equal(bones[1:, 0], bones[:-1, 1])


def test_the_space_stands_still_and_holds_the_arm_wherever_it_goes(run):
    motion = arm_motion(run)
    points, scene = motion.points.reshape(-1, 3), motion.figure.layout.scene
    assert scene.aspectmode == "manual"  # or it would follow the instant that is shown
    scales = []
    for axis, name in enumerate("xyz"):
        low, high = scene[f"{name}axis"].range
        assert low < np.nanmin(points[:, axis])
        assert high > np.nanmax(points[:, axis])
        scales.append(scene.aspectratio[name] / (high - low))
    assert scales == pytest.approx([scales[0]] * 3)
    assert 0 < scales[0] < np.inf


@pytest.mark.parametrize("scenario", ["paper_arm", "panda"])
def test_the_whole_space_around_arm_and_path_is_in_the_picture(scenario):
    short = simulate(load_setup(scenario, ["duration_s=0.2"])).data()
    for figure in (arm_motion(short).figure, tip_path(ComparedRuns([JudgedRun("law", short)]))):
        scene = figure.layout.scene
        ranges = np.array([scene[f"{name}axis"].range for name in "xyz"])
        points = np.hstack([[trace.x, trace.y, trace.z] for trace in figure.data]).T
        assert (np.nanmin(points, axis=0) > ranges[:, 0]).all()
        assert (np.nanmax(points, axis=0) < ranges[:, 1]).all()
        corners = np.array(list(product(*ranges)))
        assert np.abs(in_picture(corners, scene)).max() < 1.0


def in_picture(points, scene):
    """Where plotly's camera, which looks through 45°, sees points, 1 being its picture's edges."""
    ranges = np.array([scene[f"{name}axis"].range for name in "xyz"])
    of_scene = [[part[name] for name in "xyz"] for part in (scene.aspectratio, scene.camera.eye)]
    sides, eye = map(np.array, of_scene)
    placed = sides * ((points - ranges[:, 0]) / np.ptp(ranges, axis=1) - 0.5) - eye
    forward = np.array([scene.camera.center[name] for name in "xyz"]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    across = placed @ np.column_stack([right, np.cross(right, forward)])
    return across / (placed @ forward)[:, np.newaxis] / np.tan(np.pi / 8)


def test_a_run_without_data_has_no_arm_that_moves(run):
    assert arm_motion(build_run_data(run.setup, {}, clock="realtime", link="zenoh")) is None


def test_figures_over_time_share_an_instant_and_others_do_not(page):
    drawn = re.findall(r'data-plot="([\w-]+)-plot"( data-time="")?>', page)
    over_time = {panel.id for panel in RUN_PANELS if panel.is_over_time}
    assert {name for name, marked in drawn if marked} == over_time & {name for name, _ in drawn}
    assert {"timeline", "error-in-funnel", "torques", "tip-error"} <= over_time
    assert not {"tip-path", "arm-motion", "timing-percentiles"} & over_time


def test_the_bar_of_the_instant_can_be_paused_and_says_what_it_is(page):
    bar = re.search(r'<div id="clock"(.*?)</div>', page, re.DOTALL)[1]
    assert 'aria-label="Time of the run, in all figures"' in bar
    assert '<button type="button">Play</button>' in bar  # at rest until a click
    assert 'type="range" min="0" max="2.0' in bar
    assert "prefers-reduced-motion: reduce" in page


def test_a_report_alone_has_the_library_inside_and_is_small(page):
    packed = re.search(r'<script type="text/plain" id="library">([^<]*)</script>', page)[1]
    assert zlib.decompress(base64.b64decode(packed)).decode() == get_plotlyjs()
    assert "<script src" not in page
    assert "script-src 'unsafe-inline';" in page
    assert len(page.encode()) < MOST_BYTES


def test_a_comparison_shares_the_library_with_the_reports_of_its_laws(run, tmp_path):
    comparison = ComparedRuns([JudgedRun("fixed_time_neural", run)], [])
    folder = new_folder("x", tmp_path / "study")
    law = folder / "fixed_time_neural"
    law.mkdir()
    write_page(folder / "report.html", laws_page(comparison, {}))
    write_page(law / "report.html", run_page(JudgedRun("", run)))
    assert (folder / LIBRARY_FILE).read_text(encoding="utf-8") == get_plotlyjs()
    for file, address in ((folder, "plotly.min.js"), (law, "../plotly.min.js")):
        text = (file / "report.html").read_text(encoding="utf-8")
        assert re.findall(r'<script src="([^"]*)"', text) == [address]
        assert 'id="library"' not in text
        assert len(text.encode()) < MOST_BYTES
    assert not (law / LIBRARY_FILE).exists()
    new_folder("x", folder, overwrite=True)
    assert not (folder / LIBRARY_FILE).exists()


def test_a_shared_library_of_another_version_is_not_taken_for_ours(tmp_path):
    report = tmp_path / "run" / "report.html"
    report.parent.mkdir()
    (tmp_path / LIBRARY_FILE).write_text("/* older */")
    assert library_address(report) == ""
    share_library(tmp_path)
    assert library_address(report) == "../plotly.min.js"


def test_numbers_of_figures_are_packed_with_what_can_be_seen():
    y = np.array([1.0, np.nan, 1e-9, 12345.678])
    figure = go.Figure([go.Scatter(x=np.arange(4.0), y=y), go.Bar(x=["a"], y=[2.5])])
    line, bar = json.loads(figure_json(figure))["data"]
    np.testing.assert_allclose(floats(line["y"]), y, rtol=1e-6)
    np.testing.assert_array_equal(floats(line["x"]), np.arange(4))
    assert (bar["x"], bar["y"]) == (["a"], [2.5])
