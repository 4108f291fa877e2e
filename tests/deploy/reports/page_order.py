"""The order in which every report shows what it has."""

from __future__ import annotations

_FIRST_REASON, _MORE_REASONS = 'class="lede"', 'id="reasons"'


def assert_shows_before_it_tells(html: str) -> None:
    """Headline, first reason, one section of figures, other reasons, tables, folded conditions."""
    marks = [
        "<h1>", _FIRST_REASON, '<figure class="card"', _MORE_REASONS, "<h2>", "<table",
        '<details class="card',
    ]  # fmt: skip
    absent = {mark for mark in (_FIRST_REASON, _MORE_REASONS) if mark not in html}
    assert len(absent) < 2
    marks = [mark for mark in marks if mark not in absent]
    places = [html.index(mark, html.index("<body>")) for mark in marks]
    assert places == sorted(places), dict(zip(marks, places, strict=True))
    assert '<details class="card" id="conditions">' in html
    assert "<details open" not in html
