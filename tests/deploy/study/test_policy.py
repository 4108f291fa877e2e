"""The command `policy`: inference times that merges of chunks tolerate."""

from __future__ import annotations

import json

from deploy.studies.policy.policy_sheet import recommended
from tests.one_joint import policy_setup

CHUNKS = "controller.chunks={horizon: 16, period_ms: 20, ask_every: 8}"
SHORT = ("--set", CHUNKS, "--set", "duration_s=3")
BOUNDS = ("--limit", "320", "--resolution", "40", "--workers", "1")


def test_perfect_chunks_are_tolerated_until_they_run_out(tmp_path, funnel_hil):
    """A chunk lasts 320 ms; an answer that takes d > 160 ms is in force for 2 d after its question.

    At 200 ms the arm rests for 80 ms, 40 of 60 mrad at 0.5 rad/s; at 240 ms for 160 ms, 80 mrad.
    The frozen prefix takes at most half of its chunk.
    """
    policy_setup(tmp_path, CHUNKS, rows=16, spacing_s=0.02, knows_velocity=True, funnel_rad=0.06)
    out = tmp_path / "out"
    words = ("policy", "tests.one_joint:Policy", tmp_path / "one.yaml", "--out", out)
    shown = funnel_hil.output(*words, "--merges", "replace,frozen_prefix", *SHORT, *BOUNDS)
    found = json.loads((out / "policy.json").read_text())
    replaced, frozen = found["merges"]
    assert (replaced["inference_ms"], replaced["ends"]) == (200.0, "chunk ran out")
    assert (frozen["inference_ms"], frozen["is_limit"]) == (160.0, True)
    assert max(each["jump_rad"] for each in found["merges"]) < 1e-6
    assert replaced["age_largest_ms"] == 100.0 + 8 * 20.0 - 1.0
    assert found["recommended"] == "replace"
    assert "Recommended: replace." in shown
    assert "frozen_prefix | ≥ 160" in (out / "policy.md").read_text()


def test_unknown_merges_are_refused(funnel_hil, tmp_path):
    words = ("policy", "smc", "paper_arm", "--out", tmp_path / "out")
    assert "did you mean" in funnel_hil.output(*words, "--merges", "replac", code=2)
    assert "must be different" in funnel_hil.output(*words, "--merges", "spline,spline", code=2)


def test_the_merge_that_tolerates_most_and_jumps_least_is_recommended():
    rows = [
        {"merge": "a", "inference_ms": 100.0, "jump_rad": 0.2},
        {"merge": "b", "inference_ms": 100.0, "jump_rad": 0.1},
        {"merge": "c", "inference_ms": None, "jump_rad": 0.0},
    ]
    assert recommended(rows) == "b"
    assert recommended(rows[2:]) is None
