"""The moving picture of the README: both runs, their verdicts, and arms that move."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from deploy.judge.metrics import summarise
from scripts.experiments import moving_picture

SVG = "{http://www.w3.org/2000/svg}"


def test_picture_shows_both_arms_with_their_verdicts(monkeypatch):
    monkeypatch.setattr(moving_picture, "END_S", 1.5)
    monkeypatch.setattr(moving_picture, "FRAMES", 3)
    runs = {
        name: moving_picture.run_on_network(is_helped=is_on)
        for name, is_on in (("without", False), ("with", True))
    }
    picture = ET.fromstring(moving_picture.picture(runs))
    halves = picture.findall(f"{SVG}g")
    assert [half.find(f"{SVG}text").text for half in halves] == ["without", "with"]
    for half, run in zip(halves, runs.values(), strict=True):
        is_kept = summarise(run)["bounds"]["kept"]
        words = half.findall(f"{SVG}text")[1].text.split()
        assert words[0] == ("keeps" if is_kept else "leaves")
        moving = half.findall(f"{SVG}polyline/{SVG}animate")
        shapes = [each.get("values").split(";") for each in moving]
        assert [len(frames) for frames in shapes] == [3, 3]  # the reference and the arm
        assert len(set(shapes[1])) == 3
