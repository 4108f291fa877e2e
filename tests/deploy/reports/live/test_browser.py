"""The live view's page, and figures of reports, in a real browser."""

import asyncio
import json
import threading

import pytest
from browser import CHROMIUM, opened
from watched import playback, short_run

from deploy.reports.figures import study_figures, style
from deploy.reports.html import write_page
from deploy.reports.live.viewer import Viewer
from deploy.reports.page import Page, Panel, ReportHead
from deploy.reports.studies.study_result import Runs

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")

TRACES = (
    "id => document.getElementById(id).data.map(trace => trace.y.filter(Number.isFinite).length)"
)
BLANK_BELOW_THE_ARM_PX = """
document.getElementById("arm").parentElement.getBoundingClientRect().bottom
  - document.querySelector("#arm + figcaption").getBoundingClientRect().bottom
"""
SPACE_AROUND_AN_ARM_THAT_LEFT_IT = """
grow(figures.arm.layout.scene, { x: [0, 5], y: [0, null], z: [0, 0] }),
["x", "z"].flatMap(axis => figures.arm.layout.scene[`${axis}axis`].range)
"""


@pytest.fixture
def viewer():
    made = Viewer(short_run("duration_s=1.0").setup, "a test", foxglove_port=0)
    yield made
    made.close()


def test_the_page_draws_a_run_and_says_when_it_is_over(viewer, tmp_path):
    source = playback(short_run("duration_s=1.0"), 0.1, lambda: viewer.is_watched)
    over = threading.Event()
    server = threading.Thread(target=viewer.run, args=(source, over.is_set))
    server.start()
    seen = {}

    async def look():
        async with opened(viewer.places().split()[2], tmp_path / "profile") as page:
            await page.await_true("document.body.dataset.frames > 2")
            await page.await_true("document.querySelector('#mode').textContent == 'tracking'")
            over.set()
            await page.await_true("document.querySelector('#state').textContent.includes('over')")
            for figure in ("error", "torque", "age"):
                seen[figure] = await page.value(f"({TRACES})('{figure}')")
            seen["arm"] = await page.value("document.getElementById('arm').data[1].x.length")
            seen["from_s"] = await page.value(
                "document.getElementById('error').layout.xaxis.range[0]"
            )
            seen["space"] = await page.value(SPACE_AROUND_AN_ARM_THAT_LEFT_IT)
            seen["drawn"] = await page.value(
                "!!document.querySelector('#arm canvas, #arm .no-webgl')"
            )
            seen["blank_px"] = await page.value(BLANK_BELOW_THE_ARM_PX)
            await page.screenshot(tmp_path / "page.png")
            seen["text"] = page.messages

    try:
        asyncio.run(look())
    finally:
        over.set()
        server.join()
    assert len(seen["error"]) == 9  # two bounds and an error for each joint
    assert min(*seen["error"], *seen["torque"], *seen["age"]) >= 2
    assert seen["arm"] > 3
    assert seen["from_s"] == 0  # all of the last ten seconds
    low_x, high_x, low_z, high_z = seen["space"]
    assert low_x < high_x
    assert high_x > 5.0
    assert high_z - low_z == pytest.approx(high_x - low_x)
    assert seen["drawn"]
    assert 0 < seen["blank_px"] < 30
    assert (tmp_path / "page.png").stat().st_size > 20_000
    wrong = [
        text for text in seen["text"] if json.loads(text).get("entry", {}).get("level") != "warning"
    ]
    assert wrong == []  # no exception, and nothing that its security policy stopped


SHOWN_TICKS = """
id => Array.from(
  document.querySelectorAll(`#${id}-plot g[class^=y][class$=tick] text`), text => text.textContent
)
"""
SPANS = {"narrow": [24.0, 31.0], "decade": [3.0, 45.0], "wide": [1e-4, 100.0]}


def curve(span):
    runs = {"worst_point": "0", "runs": 1, "runs_kept": 1}
    spreads = ({"mean": y, "lowest": y, "highest": y} for y in (1e-3 * each for each in span))
    points = [
        (x, Runs.model_validate({**runs, "worst_rms_rad": spread}))
        for x, spread in enumerate(spreads)
    ]
    line, study = study_figures.Curve("smc", 0, 0, points), study_figures.DrawnStudy({}, str)
    return study_figures.curves(study, [line], "delay", study_figures.WORST_RMS)


def rows(span):
    figure = style.joint_rows(tuple("abcdefg"), "mrad")
    for row in range(1, 8):
        figure.add_scatter(x=[0, 1], y=span, row=row, col=1)
    style.log_axis(figure)
    return figure


def test_every_logarithmic_axis_has_ticks_enough_to_be_read_and_none_in_another(tmp_path):
    draws = {f"{name}-{kind.__name__}": (kind, span) for name, span in SPANS.items()
             for kind in (curve, rows)}  # fmt: skip
    panels = [Panel("drawn", name, name, lambda _, kind=kind, span=span: kind(span), "")
              for name, (kind, span) in draws.items()]  # fmt: skip
    path = tmp_path / "report.html"
    verdict = ReportHead("good", "drawn", [])
    write_page(path, Page("drawing", "ticks", verdict, [], lambda: panels, None, {}))
    shown = {}

    async def look():
        async with opened(path.as_uri(), tmp_path / "profile") as page:
            await page.await_true(f"({SHOWN_TICKS})('{list(draws)[-1]}').length > 0")
            for name in draws:
                shown[name] = await page.value(f"({SHOWN_TICKS})('{name}')")

    asyncio.run(look())
    for name, (kind, _) in draws.items():
        axes = 7 if kind is rows else 1
        assert 2 * axes <= len(shown[name]) <= (7 if kind is rows else 16) * axes, shown
