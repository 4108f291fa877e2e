"""The site builds without a warning, and shows the reference."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.deploy.docs.pages import DOCS
from tests.warm_process import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site, without executing its notebook, which has a test of its own."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", DOCS, folder]
    built = subprocess.run(
        list(map(str, command)), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.parametrize(
    ("page", "content"),
    [
        ("scenario", '<span class="pre">duration_s</span>'),
        ("commands", "--require-bounds"),
        ("topics", "float64[] sliding_variable"),
        ("python", "funnel_hil.simulate"),
    ],
)
def test_site_shows_the_reference(site, page, content):
    assert content in (site / "reference" / f"{page}.html").read_text()
