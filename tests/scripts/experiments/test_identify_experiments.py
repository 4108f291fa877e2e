"""Scripts about identified arms: how often intervals hold the truth, and a picture of torques."""

import re
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from scripts.experiments import identified_torques, identify_coverage
from tests.deploy.measure.identify.virtual_logs import excitation, truth_of, write_log

pytest.importorskip("scipy", reason="the extra identify is not installed")


def test_coverage_counts_parameters_that_hold_the_truth(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["identify_coverage", "--draws", "2", "--seed", "5", "--each"])
    identify_coverage.main()
    printed = capsys.readouterr().out
    row = re.search(r"^ +elbow: coulomb +([\d.]+) % of +(\d+) seen", printed, re.MULTILINE)
    assert row[2] == "2"
    assert float(row[1]) in (0.0, 50.0, 100.0)
    together = re.search(r"^paper_arm +0 s: +([\d.]+) % of", printed, re.MULTILINE)
    assert float(together[1]) > 60.0


def test_picture_has_three_curves_for_each_joint(tmp_path, monkeypatch, capsys):
    random = np.random.default_rng(4)
    robot, model, *_ = excitation("paper_arm", 25.0)
    write_log(tmp_path / "log.csv", "paper_arm", truth_of(robot, model, random), random)
    picture = tmp_path / "picture.svg"
    words = ["identified_torques", picture, tmp_path / "log.csv", "--robot", "paper_arm"]
    monkeypatch.setattr(sys, "argv", [*map(str, words), "--seconds", "4"])
    identified_torques.main()
    assert capsys.readouterr().out.count("%") == robot.joints
    drawn = ET.parse(picture).getroot()
    curves = drawn.findall("{http://www.w3.org/2000/svg}polyline")
    assert len(curves) == 3 * robot.joints
    y = [[float(p.split(",")[1]) for p in curve.get("points").split()] for curve in curves]
    for measured, file, identified in zip(y[::3], y[1::3], y[2::3], strict=True):
        off = np.abs(np.subtract(identified, measured)).mean()
        assert off < 0.5 * np.abs(np.subtract(file, measured)).mean()
