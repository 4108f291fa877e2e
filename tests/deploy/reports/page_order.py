"""The order in which every report shows what it has."""

from __future__ import annotations


def assert_shows_before_it_tells(html: str) -> None:
    """Headline with the first reason, one section of figures, reasons, tables, and conditions that are folded."""
    marks = (
        "<h1>", 'class="lede"', '<figure class="card"', 'id="reasons"', "<h2>", "<table", '<details class="card',
    )  # fmt: skip
    places = [html.index(mark, html.index("<body>")) for mark in marks]
    assert places == sorted(places), dict(zip(marks, places, strict=True))
    assert '<details class="card" id="conditions">' in html
    assert "<details open" not in html
