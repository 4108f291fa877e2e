"""What the README shows works as it stands there."""

import re
from pathlib import Path

import pytest
import yaml

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.explanation import _keys, _sections
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.study.robustness import margin_study
from deploy.study.sweep import load_sweep

README = (Path(__file__).resolve().parents[3] / "README.md").read_text()


def block(language, containing):
    """The only code block of a language that has a text in it."""
    found = re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)
    (only,) = (text for text in found if containing in text)
    return only


@pytest.fixture
def scenario(tmp_path):
    (tmp_path / "two_link.urdf").write_text(block("xml", "two_link"))
    (tmp_path / "two_link.yaml").write_text(block("yaml", "two_link"))
    return tmp_path / "two_link.yaml"


def test_the_table_of_keys_names_each_key_of_a_section():
    rows = dict(re.findall(r"^\| `?(\w+)`? \| (.*) \|$", README, flags=re.MULTILINE))
    listed = {"faults", "uncertainty"}  # told of where these words lead
    for key in keys_of(ScenarioConfiguration):
        section, *names = key.split(".")
        if (len(names) == 1 and section not in listed) or names[:-1] == ["can"]:
            assert re.search(rf"\b{names[-1]}\b", rows[section]), f"{key} is not in the table"
        if not names:
            assert section in rows or f"`{section}`" in rows["top"]


def keys_of(section, prefix=""):
    """Dotted keys of a section and of those in it."""
    for name, annotation in _keys(section).items():
        yield prefix + name
        for inner in _sections(annotation):
            yield from keys_of(inner, f"{prefix}{name}.")


def test_own_arm_keeps_its_bounds(scenario):
    summary = summarise(simulate(load_setup(str(scenario))).data())
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    # Derived gains track rest-to-rest moves of this arm to well below a tenth of the 10 mrad bound.
    assert max(summary["tracking"]["rms_rad"]) < 1e-3


def test_bad_link_does_what_it_says(tmp_path):
    values = yaml.safe_load((SHIPPED / "paper_arm.yaml").read_text())
    bad = yaml.safe_load(block("yaml", "burst_loss"))
    values["link"] = bad["link"]
    values["plant"] |= bad["plant"]
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(values))
    summary = summarise(simulate(load_setup(str(tmp_path / "bad.yaml"), ["duration_s=1"])).data())
    assert (summary["completed"], summary["faults"]) == (True, [])
    # Few commands come more than 12 ms late: two delays of 3 ms with a deviation of 1 ms each.
    assert summary["timing"]["round_trip_us"]["p99"] == 12_000.0
    assert summary["transport"]["uplink"]["loss_burst"]["longest"] > 1


def test_the_sweep_of_the_readme_can_be_run(tmp_path):
    (tmp_path / "sweep.yaml").write_text(block("yml", "grid:"))
    # 11 delays, 3 model scales, 5 seeds.
    assert load_sweep(str(tmp_path / "sweep.yaml")).expected == 11 * 3 * 5


def test_the_study_of_uncertain_plants_of_the_readme_can_be_run(tmp_path):
    values = yaml.safe_load(block("yml", "uncertainty:"))
    # Two laws, 4 round trips, 40 plants.
    assert margin_study(values, tmp_path / "study.yaml").expected == 2 * 4 * 40
