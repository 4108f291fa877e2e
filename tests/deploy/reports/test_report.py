from __future__ import annotations

import io
import json
import re
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
import pytest
from PIL import Image

from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.robot_description import load_robot
from deploy.judge.bounds import bound_usage
from deploy.judge.metrics import RunResult, judge, summarise
from deploy.judge.run_data import build_run_data
from deploy.reports.figures import style
from deploy.reports.figures.arm_pictures import arm_picture, arm_pictures
from deploy.reports.figures.joints import error_first_second, error_in_funnel, torques
from deploy.reports.figures.learned import unknown_dynamics_nm
from deploy.reports.figures.style import decimate
from deploy.reports.figures.timeline import deadline_misses, fault_spans_s, with_faults
from deploy.reports.html import packed_library, write_page
from deploy.reports.page import Panel
from deploy.reports.runs import run_panels
from deploy.reports.runs.run_pages import run_page
from deploy.reports.runs.run_tables import event_table, joint_table, timing_table
from deploy.reports.verdict_texts import PARTIAL, verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.study.comparison.compared_runs import ComparedRuns
from plant_emulator.physics.engines import ENGINES
from tests.arms import INSTALLED, needs_bullet
from tests.deploy.reports.page_order import assert_shows_before_it_tells

FIGURES = ("timeline", "error-in-funnel", "error-first-second", "error-envelopes",
           "transformed-error", "torques", "tip-path", "tip-error", "arm-motion",
           *(["arm"] if "bullet" in INSTALLED else []),
           "network-output", "timing-percentiles")  # fmt: skip

HOSTILE = "</script><script>alert(1)</script>"


def run_of(*overrides):
    return simulate(load_setup("paper_arm", ["duration_s=1.5", *overrides])).data()


@pytest.fixture(scope="module")
def run():
    return run_of("metrics.from_s=0.5")


@pytest.fixture(scope="module")
def late_run():
    return run_of("controller.law=pid", "link.deadline_ms=0.5")


@pytest.fixture(scope="module")
def page_of(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    pages = []

    def write(run, summary=None):
        """The report without plotly.js, which is not ours; that of a run as it is, written once."""
        for subject, page in pages:
            if subject is run and summary is None:
                return page
        write_page(path, run_page(JudgedRun("", run, summary and RunResult(**summary))))
        page = path.read_text(encoding="utf-8")
        assert page.count(packed_library()) == 1
        page = page.replace(packed_library(), "")
        if summary is None:
            pages.append((run, page))
        return page

    return write


@pytest.fixture
def only(monkeypatch):
    """Leave all panels out but these: for what stands around them, or where some take long."""

    def leave(*names):
        panels = [panel for panel in run_panels.RUN_PANELS if panel.id in names]
        monkeypatch.setattr(run_panels, "RUN_PANELS", panels)

    return leave


def test_the_page_needs_nothing_from_outside(run, page_of):
    page = page_of(run)
    sources = re.findall(r"""(?:src|href|action)\s*=\s*["']([^"']*)""", page)
    assert len(sources) == (3 if ENGINES["bullet"].is_installed else 0)  # pictures of the arm
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"https?://|@import|url\(", page)
    assert "default-src 'none'" in page
    assert "showSendToCloud: false" in page  # plotly's button that uploads a figure


def test_caption_explains_only_what_is_drawn(run):
    panels = {panel.id: panel for panel in run_panels.RUN_PANELS}
    setting = "link.uplink.pattern={shape: square, period_ms: 100}"
    late = ("metrics.from_s=0.5", "link.uplink.delay_ms=90", setting)
    played = ("link.uplink={delay_ms: 20, jitter_ms: 10}", "metrics.from_s=0.5",
              "controller.delay_compensation.enabled=true")  # fmt: skip
    fault = (
        "metrics.from_s=0.5",
        "faults=[{kind: torque_offset, joint: elbow, at_s: 0.5, torque_nm: 1}]",
    )

    def caption(name, of):
        panel, subject = panels[name], ComparedRuns([JudgedRun("", of)])
        return panel.caption_of(panel.draw(subject))

    words = {"red strip": "error-in-funnel", "Red shades": "error-in-funnel",
             "play-out": "delay-over-time", "cross": "delay-over-time"}  # fmt: skip
    runs = {"kept": run, "lost": run_of(*late), "played": run_of(*played), "faulty": run_of(*fault)}
    said = {name: {word for word, panel in words.items() if word in caption(panel, each)}
            for name, each in runs.items()}  # fmt: skip
    assert said["kept"] == set()
    assert said["lost"] == {"red strip", "cross"}
    assert "play-out" in said["played"]
    assert "Red shades" in said["faulty"]


def test_a_report_has_every_figure_with_a_caption(run, page_of):
    page = page_of(run)
    for name in FIGURES:
        assert f'<figure class="card" id="{name}">' in page
    assert page.count("<figcaption>") == len(FIGURES)


def test_the_report_of_a_run_shows_before_it_tells(run, page_of):
    page = page_of(run)
    assert_shows_before_it_tells(page)
    folded = page.index('<details class="card folded">')
    assert page.index('id="error-in-funnel"') < page.index('id="tip-path"') < folded
    assert page[: page.index("<h2>")].count("<figure") == 1  # the errors, before all other reasons
    assert "paper_arm · fixed_time_neural · no link delay · 1.5 s" in page[: page.index("<h1>")]
    assert folded < page.index('id="timing-percentiles"')


@pytest.mark.parametrize("draw", [error_in_funnel, error_first_second])
def test_times_outside_the_bounds_are_a_strip_below_the_line_that_hides_nothing(draw):
    lost = run_of("metrics.from_s=0.5", "link.uplink.delay_ms=40")
    times_s, outside = lost.times_s(PLANT_TRUTH), bound_usage(lost) >= 1.0
    shown = times_s <= 1.0 if draw is error_first_second else times_s >= 0.0
    figure = draw(ComparedRuns([JudgedRun("", lost)]))
    assert not [trace for trace in figure.data if "markers" in (trace.mode or "")]
    strips = [trace for trace in figure.data if trace.name == "outside the bounds"]
    assert len(strips) == outside[shown].any(axis=0).sum() > 0
    axes = [*figure.select_yaxes()]
    for strip in strips:
        joint = int(strip.yaxis[1:] or 1) - 1
        low, high = axes[joint].range
        assert set(strip.y) == {low}
        assert high == -low
        begins, ends = strip.x[::3], strip.x[1::3]
        times = times_s[shown][outside[shown][:, joint]]
        inside = (begins[:, None] <= times) & (times <= ends[:, None] + 1e-9)
        assert inside.any(axis=0).all()  # no tick is left out
        assert inside.any(axis=1).all()  # and no part of the strip has none


def test_a_joint_has_one_colour_in_all_figures_and_nothing_else_has_it(run):
    """Colours of traces by the joint in whose row they are; those of the tip's figures apart."""
    joints = run.setup.robot.joint_names
    own = {name: style.palette(place) for place, name in enumerate(joints)}
    subject, seen = ComparedRuns([JudgedRun("", run)]), set()
    for panel in run_panels.RUN_PANELS:
        if panel.is_folded or panel.is_drawn_beside:
            continue
        figure = panel.draw(subject)
        figure = getattr(figure, "figure", figure)
        if not isinstance(figure, go.Figure):
            continue
        rows = [note.text for note in figure.layout.annotations]
        for trace in figure.data:
            row = int((getattr(trace, "yaxis", None) or "y1").removeprefix("y") or 1) - 1
            allowed = own[rows[row]] if tuple(rows[: len(joints)]) == joints else None
            colour = trace.line.color
            assert colour == allowed or colour not in own.values(), (panel.id, colour)
            seen |= {(panel.id, colour)} if colour == allowed else set()
    assert len({colour for name, colour in seen if name == "error-envelopes"}) == len(joints)


def test_what_a_law_does_not_have_is_left_out(late_run, page_of, only):
    only("torques", "network-output", "transformed-error")
    page = page_of(late_run)
    assert 'id="torques"' in page
    assert 'id="network-output"' not in page
    assert 'id="transformed-error"' not in page


def test_the_verdict_on_a_run_that_kept_its_bounds(run, page_of):
    page = page_of(run)
    assert "<h1>Bounds kept</h1>" in page
    assert "inside its bounds at all 1,500 ticks" in page
    assert run.digest[:12] in page


def test_the_verdict_on_a_run_that_left_its_bounds(run):
    summary = summarise(run) | {"verdict": "lost"}
    summary["bounds"] |= {"kept": False, "violation_fraction": 0.25, "first_violation_s": 0.125}
    verdict = verdict_on_run(JudgedRun("", run, RunResult(**summary)))
    assert verdict.headline == "Bounds not kept"
    assert (
        "outside its bounds at 25 % of the ticks, for the first time at 0.125 s"
        in (verdict.reasons[0])
    )


def test_a_partial_recording_is_called_partial(run):
    partial = replace(run, complete=False)
    verdict = verdict_on_run(JudgedRun("", partial))
    assert verdict.headline == (
        "Not known whether bounds were kept, inside its bounds at all known ticks"
    )
    assert PARTIAL in verdict.reasons


def test_texts_from_a_run_are_shown_and_never_executed(run, page_of, only):
    only(*set(FIGURES) - {"arm"})
    fault = RunEvent(10**9, "plant", EventKind.FAULT, HOSTILE)
    hostile_run = replace(run, events=[*run.events, fault])
    summary = summarise(hostile_run)
    summary["scenario"] = HOSTILE
    summary["tracking"]["joint_names"][0] = HOSTILE
    summary["transport"]["uplink"]["rejected"] = {HOSTILE: 3}
    page = page_of(hostile_run, summary)
    assert "<h1>Run ended by a fault, inside its bounds at all known ticks</h1>" in page
    assert "<script>alert" not in page
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 6


def test_joint_names_are_plain_text_in_figures(run):
    robot = replace(run.setup.robot, joint_names=(HOSTILE, "shoulder", "elbow"))
    figure = torques(replace(run, setup=replace(run.setup, robot=robot)))
    assert "<" not in figure.to_json()


def test_a_run_without_any_data_still_has_a_report(run, page_of):
    empty = build_run_data(run.setup, {}, clock="realtime", link="zenoh", complete=False)
    page = page_of(empty)
    assert "<h1>Nothing was recorded</h1>" in page
    assert "No tick was recorded" in page
    assert "Nothing was recorded that could be drawn" in page


def test_every_deadline_missed_fills_its_figure(run, late_run):
    assert deadline_misses(run) is None
    figure = deadline_misses(late_run)
    assert max(figure.data[0].y) == pytest.approx(100.0)


def test_events_are_in_the_order_of_their_time_and_in_words():
    plant = RunEvent(4_000_000, "plant", EventKind.LIMIT, "reached for the first time: velocity")
    counted = {"late": 0, "wall_s": 0.25, "rejected": {}, "limits": {"torque_rate": 7, "speed": 0}}
    controller = RunEvent(3_000_000, "controller", EventKind.ENDED, json.dumps(counted))
    data = build_run_data(
        load_setup("paper_arm"), {"run_events": [plant.encode(), controller.encode()]},
        clock="virtual", link="in_process",
    )  # fmt: skip
    assert event_table(data).rows == [
        ["0.003", "controller", "ended",
         "late 0, wall 0.25 s, rejected: none, limits: torque rate 7"],
        ["0.004", "plant", "limit", "reached for the first time: velocity"],
    ]  # fmt: skip


def test_the_rows_of_sliding_joints_name_their_units(run):
    """Headings name mrad and N m."""
    rows = joint_table(judge(run), 0.5, (False, True, False)).rows
    assert [row[0] for row in rows] == ["base_yaw", "shoulder (mm, N)", "elbow"]


def test_times_that_are_always_0_take_no_row(run):
    table = timing_table(judge(run))
    assert [row[0] for row in table.rows] == ["Command age", "Control step"]
    assert table.note.endswith("All samples are 0: round trip, state age, wake-up lateness.")


def test_the_network_learns_what_the_report_compares_it_with(run):
    _, truth = unknown_dynamics_nm(run, 2000)
    status = run.tables["control_status"]["network_output"]
    assert np.abs(status[-100:] - truth[-101:-1]).max() < 0.1 * np.abs(truth[-100:]).max()


def test_fewer_points_of_the_dynamics_are_some_of_all_of_them(run):
    all_times_s, of_all = unknown_dynamics_nm(run, 2000)
    times_s, of_some = unknown_dynamics_nm(run, 400)
    assert len(all_times_s) == len(run.tables["plant_truth"])
    assert 300 < len(times_s) <= 400
    np.testing.assert_array_equal(of_some, of_all[np.isin(all_times_s, times_s)])


@pytest.mark.parametrize("points", [3, 4000, 4001, 20_001])
def test_decimation_keeps_order_and_extremes(points):
    random = np.random.default_rng(points)
    x, y = np.arange(points, dtype=float), random.standard_normal(points)
    y[points // 2] = np.nan
    few_x, few_y = decimate(x, y)
    assert len(few_x) <= 4000
    assert np.all(np.diff(few_x) > 0)
    assert np.array_equal(y[few_x.astype(int)], few_y, equal_nan=True)
    assert np.nanmin(few_y) == np.nanmin(y)
    assert np.nanmax(few_y) == np.nanmax(y)


def test_decimation_keeps_gaps():
    _, few = decimate(np.arange(100.0), np.full(100, np.nan), 10)
    assert np.isnan(few).all()


@needs_bullet
def test_the_pictures_of_a_report_show_start_middle_and_end(run):
    pictures = arm_pictures(run)()
    assert [picture.time_s for picture in pictures] == pytest.approx([0.0, 0.75, 1.5])
    for picture in pictures:
        image = Image.open(io.BytesIO(picture.png))
        assert (image.format, image.size) == ("PNG", (480, 420))
        assert 500 < (np.asarray(image) < 255).any(axis=2).sum() < 480 * 420 / 2


@needs_bullet
def test_arm_without_shapes_is_drawn_as_a_skeleton(run, tmp_path):
    file = tmp_path / "bare.urdf"
    text = run.setup.robot.path.read_text()
    file.write_text(re.sub("<visual.*?</visual>", "", text, flags=re.DOTALL))
    robot = load_robot(file)
    image = np.asarray(Image.open(io.BytesIO(arm_picture(robot, np.array([0.2, -0.6, 0.9])))))
    drawn = (image < 255).any(axis=2)
    assert 2000 < drawn.sum() < 480 * 420 / 4
    rows, columns = np.nonzero(drawn)
    assert max(np.ptp(rows) / 420, np.ptp(columns) / 480) > 0.75  # it fills the picture


def test_a_panel_from_outside_is_one_entry_of_the_table(run, page_of, only, monkeypatch):
    only("error-in-funnel", "tip-path")

    def speed(runs):
        truth = runs.runs[0].data.tables["plant_truth"]
        return go.Figure(go.Scatter(y=truth["velocity"][:, 0]), {"height": 300})

    mine = Panel("Motion", "mine", "Speed of <the> first joint", speed, "It stops at the end.")
    monkeypatch.setattr(run_panels, "RUN_PANELS", [*run_panels.RUN_PANELS, mine])
    page = page_of(run, summarise(run))  # written anew
    assert '<figure class="card" id="mine"><h3>Speed of &lt;the&gt; first joint</h3>' in page
    assert "<figcaption>It stops at the end.</figcaption>" in page
    shown = re.search(r'data-plot="mine-plot">(.*?)</script>', page)
    assert json.loads(shown[1])["layout"]["height"] == 300
    assert page.count("<h2>Motion</h2>") == 1


def test_hundreds_of_faults_are_one_shape_in_each_row():
    """Plotly takes its time for each shape, and hundreds of faults had a report take minutes."""
    faults = [{"kind": "encoder_stuck", "joint": "elbow", "at_s": 0.001 * at, "for_s": 5e-4}
              for at in range(1, 500)]  # fmt: skip
    run = run_of(f"faults={json.dumps(faults)}", "duration_s=0.6", "metrics.from_s=0.1")
    spans = fault_spans_s(run)
    assert len(spans) == len(faults)
    alone = ComparedRuns([JudgedRun("law", run)])
    plain, shaded = error_in_funnel(alone), with_faults(error_in_funnel)(alone)
    shapes = shaded.layout.shapes[len(plain.layout.shapes) :]
    assert len({(shape.xref, shape.yref) for shape in shapes}) == len(shapes)
    assert len(shapes) == len(list(shaded.select_yaxes()))
    other = replace(run, setup=load_setup("paper_arm", ["duration_s=0.6"]))
    mixed = ComparedRuns([*alone.runs, JudgedRun("without faults", other)])
    assert len(with_faults(error_in_funnel)(mixed).layout.shapes) == len(plain.layout.shapes)
    for shape in shapes:
        assert shape.path.count("M") == len(faults)
        assert shape.path.startswith(f"M{spans[0][0]},0 L{spans[0][0]},1 L{spans[0][1]},1 ")


def test_what_is_drawn_into_rows_of_joints_is_not_in_the_next_ones():
    names = ("yaw", "elbow")
    drawn, before = style.joint_rows(names, "mrad"), style.joint_rows(names, "mrad").to_dict()
    drawn.add_scatter(x=[0.0], y=[1.0], row=2, col=1)
    drawn.add_hline(1.0, row=1, line=style.DOTTED)
    drawn.update_yaxes(range=[-1.0, 1.0], title_text="N m")
    drawn.layout.annotations[0].text = "wrist"
    assert style.joint_rows(names, "mrad").to_dict() == before
