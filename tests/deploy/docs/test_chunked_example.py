"""The example of a policy in chunks, whose law is not imported where commands check it."""

from __future__ import annotations

import json
import shutil

from tests.deploy.docs.pages import DOCS
from tests.warm_process import WITHOUT_REPORT, WarmProcess


def test_it_keeps_its_bounds_and_says_how_its_chunks_follow(tmp_path):
    """An age of at most 100 ms and six actions of 40 ms; a target goes on between two of them."""
    folder = shutil.copytree(DOCS / "examples/chunked-policy", tmp_path / "example")
    words = ("simulate", "scenario.yaml", "--set", "duration_s=2", "--out", folder / "out")
    process = WarmProcess(*words, cwd=folder, main=WITHOUT_REPORT)
    output, _ = process.communicate()
    assert process.returncode == 0, output
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["verdict"] == "kept"
    assert summary["chunks"]["age_ms"]["largest"] == 100 + 6 * 40 - 1
    assert summary["chunks"]["jump_rad"] > 0.0
