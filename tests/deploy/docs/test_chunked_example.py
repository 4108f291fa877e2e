"""The example of a policy in chunks, whose law is not imported where commands check it."""

from __future__ import annotations

import json
import shutil

from tests.deploy.docs.pages import DOCS, block, commands
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


def test_the_policy_of_the_page_moves_arms(tmp_path):
    """It knows the reference and makes up for the robot's lag, so no answer changes a target.

    The command of the page runs in a folder that has nothing else, and one with an arm's file.
    """
    page = "how-to/policies.md"
    (tmp_path / "my_policy.py").write_text(block(page, "python", "class Policy"))
    (of_page,) = commands(block(page, "sh", "my_policy:Policy ur5e_motors"))
    shutil.copy(DOCS / "examples/chunked-policy/so101.urdf", tmp_path)
    for name, words in (
        ("page", of_page[1:]),
        ("file", ["policy", "my_policy:Policy", "so101.urdf", "--resolution", "100"]),
    ):
        short = ("--merges", "replace", "--limit", "100", "--workers", "1", "--out", name)
        process = WarmProcess(*words, *short, cwd=tmp_path, main=WITHOUT_REPORT)
        output, _ = process.communicate()
        assert process.returncode == 0, output
        (case,) = json.loads((tmp_path / name / "summary.json").read_text())["cases"]
        assert case["inference_ms"] == 100.0
        assert case["at"]["jump_rad"] < 1e-9
