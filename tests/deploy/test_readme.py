"""The README's own arm and scenario work as they stand there."""

import re
from pathlib import Path

import pytest

from deploy.experiments.metrics import summarise
from deploy.experiments.simulate import simulate
from deploy.experiments.sweep import load_sweep
from deploy.scenario import load_setup

README = (Path(__file__).resolve().parents[2] / "README.md").read_text()


def block(language):
    """The only code block of a language."""
    found = re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)
    assert len(found) == 1
    return found[0]


@pytest.fixture
def scenario(tmp_path):
    (tmp_path / "two_link.urdf").write_text(block("xml"))
    (tmp_path / "two_link.yaml").write_text(block("yaml"))
    return tmp_path / "two_link.yaml"


def test_own_arm_keeps_its_bounds(scenario):
    summary = summarise(simulate(load_setup(str(scenario))).data())
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    # Derived gains track rest-to-rest moves of this arm to well below a tenth of the 10 mrad bound.
    assert max(summary["tracking"]["rms_rad"]) < 1e-3


def test_the_sweep_of_the_readme_can_be_run(tmp_path):
    (tmp_path / "sweep.yaml").write_text(block("yml"))
    # 11 delays, 3 model scales, 5 seeds.
    assert load_sweep(str(tmp_path / "sweep.yaml")).expected == 11 * 3 * 5
