"""`controller.model`: the nominal model has masses of another file."""

import re

import pytest

from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from tests.arms import PAPER_ARM
from tests.warm_process import output_of


@pytest.fixture
def lighter(tmp_path):
    """The paper arm's file with 0.8 of its masses and inertias."""
    text = PAPER_ARM.portable_urdf()
    pattern = r'((?:mass value|i[xyz]{2})=")([-\d.e]+)"'
    file = tmp_path / "lighter.urdf"
    file.write_text(re.sub(pattern, lambda m: f'{m[1]}{0.8 * float(m[2])!r}"', text))
    return file


def worst(*overrides: str) -> float:
    words = ["duration_s=1", "controller.law=fixed_time_model_based", "metrics.from_s=0.5"]
    run = simulate(load_setup("paper_arm", [*words, *overrides])).data()
    return float(abs(run.true_errors_rad[-300:]).max())


def test_model_of_a_file_is_as_its_masses(lighter):
    by_file = worst(f"controller.model={lighter}", "controller.model_scale=1")
    assert by_file == pytest.approx(worst("controller.model_scale=0.8"), rel=1e-6)
    assert by_file != pytest.approx(worst("controller.model_scale=1"), rel=1e-3)


def test_recording_has_the_file_and_replays(lighter, tmp_path):
    output_of("simulate", "paper_arm", "--set", "duration_s=0.2", "--set",
                        f"controller.model={lighter}", "--out", tmp_path / "run")  # fmt: skip
    lighter.unlink()
    output_of("replay", tmp_path / "run")
    load_setup(str(tmp_path / "run" / "scenario.yaml"))


def test_unusable_files_are_refused(lighter, tmp_path):
    with pytest.raises(ScenarioError, match=r"controller\.model = .*no such file"):
        load_setup("paper_arm", ["controller.model=nowhere.urdf"])
    with pytest.raises(ScenarioError, match=r"controller\.model = 'panda'.*some of panda_joint1"):
        load_setup("paper_arm", ["controller.model=panda"])
