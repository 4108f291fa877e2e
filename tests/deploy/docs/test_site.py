"""The site builds without a warning, and its generated tables are complete."""

from __future__ import annotations

import subprocess
import sys

import pytest

from deploy.scenario.definition import ScenarioConfiguration
from tests.deploy.docs.pages import DOCS
from tests.deploy.docs.test_pages import keys_of
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


def test_reference_has_each_key_of_a_scenario(site):
    page = (site / "reference" / "scenario.html").read_text()
    for key in keys_of(ScenarioConfiguration):
        assert f'<span class="pre">{key.rpartition(".")[2]}</span>' in page, key


@pytest.mark.parametrize(
    ("page", "content"),
    [
        ("commands", "--require-bounds"),
        ("commands", "funnel-hil keys init"),
        ("results", "tracking.settling_bound_s"),
        ("results", "uplink_delay_p99_9_ms"),
        ("topics", "float64[] sliding_variable"),
        ("topics", "robot_description"),
        ("python", "funnel_hil.simulate"),
        ("uncertainty", "log_uniform"),
    ],
)
def test_reference_comes_from_the_code(site, page, content):
    assert content in (site / "reference" / f"{page}.html").read_text()
