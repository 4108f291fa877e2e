"""Figures of reports as a real browser draws them."""

import asyncio

import pytest
from browser import CHROMIUM, opened

from deploy.reports.figures import study_figures, style
from deploy.reports.page import Page, Panel, write_page
from deploy.reports.verdict import ReportHead

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")

SHOWN_TICKS = """
id => Array.from(
  document.querySelectorAll(`#${id}-plot g[class^=y][class$=tick] text`), text => text.textContent
)
"""
SPANS = {"narrow": [24.0, 31.0], "decade": [3.0, 45.0], "wide": [1e-4, 100.0]}


def curve(span):
    points = [
        (x, {"worst_rms_rad": {"mean": y, "lowest": y, "highest": y}, "worst_point": "0"})
        for x, y in enumerate(1e-3 * value for value in span)
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
    write_page(path, Page("drawing", "ticks", verdict, [], panels, None, {}))
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
