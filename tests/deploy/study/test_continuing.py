"""Interrupted studies of every kind continue, with the table of one that was not interrupted."""

from __future__ import annotations

import pytest

from deploy.study.execution.runner import retrace
from tests.deploy.study.studies import (
    NOISE,
    TIED,
    Here,
    conduct,
    folder_of,
    limits,
    made_up,
    make_sweep,
    margin_of,
)
from tests.deploy.study.test_follow_ups import below_six, disturbed, helped
from tests.deploy.study.test_patterns import patterns_of, squares_lose
from tests.deploy.study.test_robustness import heavy_ones_lost, robustness_of

KINDS = {
    "sweep": (lambda folder: make_sweep(folder, {TIED: [0, 1, 2]}, seeds=4), made_up, 5),
    "margins": (lambda _: margin_of(), limits, 17),
    "margins of all runs": (lambda _: margin_of(exhaustive=True), limits, 17),
    "patterns": (lambda _: patterns_of(), squares_lose, 30),
    "remedies": (lambda _: helped(), below_six, 8),
    "disturbances": (lambda _: disturbed(), lambda run: made_up(run, motion="same"), 9),
    "plants": (lambda _: robustness_of(seeds=2, set=NOISE), heavy_ones_lost, 7),
}


@pytest.mark.parametrize("kind", KINDS)
def test_interrupted_study_continues_and_repeats_no_run(kind, tmp_path):
    make, do, at_most = KINDS[kind]
    study = make(tmp_path)
    done, whole = conduct(study, tmp_path / "whole", Here(do, seed=1))
    assert done
    first, second = Here(do, seed=2, at_most=at_most), Here(do, seed=3)
    first.count = second.count = 0  # no run ahead of its request
    interrupted = make(tmp_path)
    done, kept = conduct(interrupted, tmp_path / "stopped", first)
    assert not done
    assert len(kept.rows) == at_most
    assert not interrupted.summary(kept.rows)["completed"]
    done, folder = conduct(make(tmp_path), tmp_path / "stopped", second)
    assert done
    assert len(second.submitted) == len(whole.rows) - at_most
    assert folder.rows_file.read_bytes() == whole.rows_file.read_bytes()
    reported = make(tmp_path)
    retrace(reported, again := folder_of(reported, tmp_path / "stopped"))
    assert reported.summary(again.rows) == study.summary(whole.rows)
