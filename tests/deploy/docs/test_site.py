"""The site builds without a warning, and shows the reference."""

from __future__ import annotations

import subprocess
import sys

from tests.deploy.docs.pages import DOCS
from tests.warm_process import ROOT

CONTENTS = {
    "scenario": '<span class="pre">duration_s</span>',
    "commands": "--require-bounds",
    "topics": "float64[] sliding_variable",
    "python": "funnel_hil.simulate",
}


def test_site_builds_without_a_warning_and_shows_the_reference(tmp_path):
    """Without executing its notebook, which has a test of its own."""
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", DOCS, tmp_path]
    built = subprocess.run(
        list(map(str, command)), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    reference = tmp_path / "reference"
    lacking = {
        page: content
        for page, content in CONTENTS.items()
        if content not in (reference / f"{page}.html").read_text()
    }
    assert not lacking
