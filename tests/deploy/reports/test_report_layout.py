"""Reports of arms with long names show all they contain, on a screen and on a telephone."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from deploy.judge.metrics import RunResult, summarise
from deploy.reports.html import write_page
from deploy.reports.runs.run_pages import run_page
from deploy.reports.studies.results import study_page
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.scenario import load_setup

sys.path.append(str(Path(__file__).parent / "live"))
from browser import CHROMIUM, opened

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")

NAMES = {
    "base_yaw": "shoulder_lift_joint",
    "shoulder": "left_manipulator_shoulder_flexion_joint_of_the_second_arm",
    "elbow": "LeftManipulatorElbowFlexionJointOfTheSecondArmInTheLaboratory",
}
CLIPPED = """
(() => {
  const found = [], root = document.documentElement;
  const name = (what, e, ...sizes) => found.push([what, e.tagName, e.className,
    e.closest(".card")?.querySelector("h1, h2, h3")?.textContent,
    e.textContent.trim().slice(0, 40), ...sizes].join(" "));
  const isBeyond = (e, frame) => {
    const inner = e.getBoundingClientRect(), outer = frame.getBoundingClientRect();
    return inner.width && (inner.right > outer.right + 1 || inner.left < outer.left - 1);
  };
  if (root.scrollWidth > root.clientWidth) name("page", root, root.scrollWidth);
  for (const e of document.querySelectorAll("main :not(.plot, .plot *)")) {
    const isBlock = getComputedStyle(e).display != "inline" && e.clientWidth;
    if (isBlock && e.scrollWidth > e.clientWidth + 1) name("clipped", e, e.scrollWidth);
    const card = e.parentElement.closest(".card");
    if (card && isBeyond(e, card)) name("beyond its card", e);
    const isCell = ["TD", "TH"].includes(e.tagName) && e.clientWidth;
    if (isCell && e.textContent.trim().length > 3 && e.clientWidth < 45) name("squeezed", e);
  }
  for (const e of document.querySelectorAll(".plot .main-svg text"))
    if (isBeyond(e, e.closest(".plot"))) name("beyond its figure", e);
  return found;
})()
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of an arm that leaves its bounds, with messages lost and rejected."""
    folder = tmp_path_factory.mktemp("long_names")
    text = (ROBOTS / "paper_arm.urdf").read_text()
    for before, name in NAMES.items():
        text = text.replace(f'joint name="{before}"', f'joint name="{name}"')
    (folder / "arm.urdf").write_text(text)
    run = simulate(
        load_setup(
            "paper_arm",
            [f"robot.urdf={folder / 'arm.urdf'}", "plant.disturbance.terms=[]", "duration_s=0.5",
             "metrics.from_s=0.2", "link.uplink.jitter_ms=1", "link.uplink.loss=0.05",
             "link.downlink.delay_ms=8"],
        )
    ).data()  # fmt: skip
    summary = summarise(run)
    assert len(summary["bounds"]["margin_min_joint"]) > 50
    page = run_page(JudgedRun("", run, RunResult(**summary)), {"set": ["x" * 300]})
    write_page(folder / "report.html", page)
    return folder / "report.html"


def seen(path, width_px, profile, drawn, *scripts):
    """What scripts find in a report of this width, once all of these conditions hold."""

    async def found():
        async with opened(path.as_uri(), profile) as page:
            await page.call(
                "Emulation.setDeviceMetricsOverride",
                width=width_px, height=1200, deviceScaleFactor=1, mobile=width_px < 600,
            )  # fmt: skip
            await page.call("Page.reload")
            for condition in drawn:
                await page.await_true(condition)
            return [await page.value(script) for script in scripts]

    return asyncio.run(found())


@pytest.mark.parametrize("width_px", [1600, 390])
def test_nothing_in_a_report_is_clipped(width_px, report, tmp_path):
    drawn = ["document.querySelectorAll('.plot .main-svg text').length > 20"]
    assert seen(report, width_px, tmp_path / "profile", drawn, CLIPPED) == [[]]


OVERLAPS = """
[...document.querySelectorAll('.plot')].flatMap((plot) => {
  const boxes = [...plot.querySelectorAll('.legendtext, .bartext')].map((text) => {
    const { left, right, top, bottom } = text.getBoundingClientRect();
    return { text: text.textContent, left, right, top, bottom };
  });
  return boxes.flatMap((one, place) => boxes.slice(place + 1)
    .filter((other) => one.left < other.right - 1 && other.left < one.right - 1
      && one.top < other.bottom - 2 && other.top < one.bottom - 2)
    .map((other) => `${plot.id}: ${one.text} and ${other.text}`));
})
"""


@pytest.fixture(scope="module")
def margins(tmp_path_factory):
    """The report of the margins of five laws, each without and with compensation."""
    runs = {"runs": 2, "runs_kept": 1, "runs_failed": 0, "worst_point": "a", "points": ["a"],
            "worst_rms_rad": {"mean": 2e-3, "lowest": 1e-3, "highest": 3e-3}}  # fmt: skip
    case = {
        "arm": "my_arm", "drive_feedback": None, "running": False, "growth": 1,
        "held_arm_ceiling_ms": 165.9, "margin": 112.5, "first_failure": None, "held_again": [],
        "completed": True, "probes": [{**runs, "value": value} for value in (4.0, 112.5)],
    }  # fmt: skip
    summary = {
        "kind": "margin", "name": "m", "quantity": "delay", "title": "round trip", "unit": "ms",
        "resolution": 0.5, "limit": 128.0, "completed": True, "runs": 32, "runs_failed": 0,
        "seeds": [1], "offsets": [1.0], "duration_s": {"my_arm": 8.0}, "conditions": {"law": "all"},
        "cases": [{**case, "law": f"fixed_time_law_{law}", "compensation": has_it}
                  for law in range(5) for has_it in (False, True)],
    }  # fmt: skip
    folder = SimpleNamespace(rows_file=Path("rows.parquet"), rerun_command=str)
    path = tmp_path_factory.mktemp("margins") / "report.html"
    write_page(path, study_page(summary, folder))
    return path


@pytest.mark.parametrize("width_px", [1600, 390])
def test_labels_of_many_laws_do_not_overlap(width_px, margins, tmp_path):
    drawn = ["document.querySelectorAll('.bartext').length == 10",
             "document.querySelectorAll('.legendtext').length > 10"]  # fmt: skip
    found = seen(margins, width_px, tmp_path / "profile", drawn, CLIPPED, OVERLAPS)
    assert found == [[], []]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_and_figures_follow_the_colour_scheme(scheme, margins, tmp_path):
    """Lightness of the cards, of their text and of the text of the figures, from 0 to 1."""
    lightness = (
        "(() => { const of = (selector, key) => Math.max(...getComputedStyle("
        "document.querySelector(selector))[key].match(/\\d+/g).slice(0, 3)) / 255;"
        " return [of('.card', 'backgroundColor'), of('.card td', 'color'),"
        " of('.plot .xtick text', 'fill'), of('.plot .bg', 'fill')]; })()"
    )

    async def found():
        async with opened(margins.as_uri(), tmp_path / "profile") as page:
            await page.call(
                "Emulation.setEmulatedMedia",
                features=[{"name": "prefers-color-scheme", "value": scheme}],
            )
            await page.call("Page.reload")
            await page.await_true("document.querySelectorAll('.bartext').length == 10")
            return await page.value(lightness)

    card, text, tick, plot = asyncio.run(found())
    is_dark = scheme == "dark"
    assert (card < 0.2, plot < 0.2, text > 0.7, tick > 0.7) == (is_dark,) * 4


def test_a_click_on_a_heading_sorts_its_table_and_a_second_one_turns_it_round(report, tmp_path):
    click = "document.querySelectorAll('main > .panels thead th')[1].click()"
    rows = "[...document.querySelector('main > .panels tbody').rows]"
    cells = f"{rows}.map(row => parseFloat(row.cells[1].textContent))"

    async def sorted_twice():
        async with opened(report.as_uri(), tmp_path / "profile") as page:
            await page.await_true("document.querySelectorAll('thead th[tabindex]').length > 3")
            found = []
            for _ in range(2):
                await page.value(click)
                found.append(await page.value(cells))
            return found

    rising, falling = asyncio.run(sorted_twice())
    assert len(set(rising)) == 3
    assert rising == sorted(rising)
    assert falling == rising[::-1]
