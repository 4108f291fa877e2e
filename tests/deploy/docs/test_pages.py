"""What the pages and READMEs show works: files, studies, commands, keys and links."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from deploy.cli.commands import COMMANDS, LazyCommand
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.checking.explanation import _keys, _sections
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.xacro_arguments import join_arguments
from deploy.studies.margin.margin_study import margin_study
from deploy.studies.sweep.sweep import load_sweep
from tests.deploy.docs.pages import DOCS, PAGES, block, blocks, commands
from tests.warm_process import ROOT

ROOMS = [
    ROOT / room / "README.md" for room in ("bus_schema", "controller", "plant_emulator", "deploy")
]
OUTSIDE = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *ROOMS,
    ROOT / "plant_emulator/drives/README.md",
]


def keys_of(section, prefix=""):
    """Dotted keys of a section and of those in it."""
    for name, annotation in _keys(section).items():
        yield prefix + name
        for inner in _sections(annotation):
            yield from keys_of(inner, f"{prefix}{name}.")


KEYS = set(keys_of(ScenarioConfiguration))


def name_of(page):
    return str(page.relative_to(ROOT))


def test_own_arm_keeps_its_bounds(tmp_path):
    page = "tutorials/your-arm.md"
    (tmp_path / "two_link.urdf").write_text(block(page, "xml", "two_link"))
    (tmp_path / "two_link.yaml").write_text(block(page, "yaml", "two_link"))
    summary = summarise(simulate(load_setup(str(tmp_path / "two_link.yaml"))).data())
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    # Derived gains track rest-to-rest moves of this arm to well below a tenth of the 10 mrad bound.
    assert max(summary["tracking"]["rms_rad"]) < 1e-3


def test_bad_link_does_what_the_page_says(tmp_path):
    values = yaml.safe_load((SHIPPED / "paper_arm.yaml").read_text())
    bad = yaml.safe_load(block("how-to/bad-link.md", "yaml", "burst_loss"))
    values["link"] = bad["link"]
    values["plant"] |= bad["plant"]
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(values))
    summary = summarise(simulate(load_setup(str(tmp_path / "bad.yaml"), ["duration_s=1"])).data())
    assert (summary["completed"], summary["faults"]) == (True, [])
    # Few commands come more than 12 ms late: two delays of 3 ms with a deviation of 1 ms each.
    assert summary["timing"]["round_trip_us"]["p99"] == 12_000.0
    assert summary["transport"]["uplink"]["loss_burst"]["longest"] > 1


def test_sweep_of_the_page_can_be_run(tmp_path):
    (tmp_path / "sweep.yaml").write_text(block("how-to/sweep.md", "yaml", "grid:"))
    # 11 delays, 3 model scales, 5 seeds.
    assert load_sweep(str(tmp_path / "sweep.yaml")).expected == 11 * 3 * 5


def test_study_of_uncertain_plants_of_the_page_can_be_run(tmp_path):
    values = yaml.safe_load(block("how-to/uncertain-plants.md", "yaml", "uncertainty:"))
    # Two laws, 4 round trips, 40 plants.
    assert margin_study(values, tmp_path / "study.yaml").expected == 2 * 4 * 40


def test_parts_of_scenarios_on_pages_can_be_used(tmp_path):
    delays = "".join(f"{delay_ms}\n" for delay_ms in range(1, 5))
    (tmp_path / "measured_delays.csv").write_text(delays)
    joints = ",".join(f"{name}.position_rad" for name in load_setup("paper_arm").robot.joint_names)
    rows = "".join(f"{time_s},0,0,0\n" for time_s in range(30))
    (tmp_path / "ref.csv").write_text(f"time_s,{joints}\n{rows}")
    found = 0
    for page in PAGES:
        for each in blocks(page):
            part = yaml.safe_load(each.text) if each.language == "yaml" else {}
            if part and part.keys() <= ScenarioConfiguration.model_fields.keys() - {"name"}:
                values = {"extends": "paper_arm", "name": "part", **part}
                (tmp_path / "part.yaml").write_text(yaml.safe_dump(values))
                load_setup(str(tmp_path / "part.yaml"))
                found += 1
    assert found >= 5


def test_python_of_the_readme_runs(capsys):
    for each in blocks(ROOT / "README.md"):
        if each.language == "python":
            exec(each.text, {})
    verdict, margins = capsys.readouterr().out.splitlines()[:2]
    assert verdict.startswith("lost ")
    assert "'smc'" in margins


@pytest.mark.parametrize("page", [*PAGES, *OUTSIDE], ids=name_of)
def test_commands_and_keys_of_a_page_exist(page):
    for each in blocks(page):
        if "yaml" in each.language and "caption" not in each.text:
            yaml.safe_load(each.text)
        for words in commands(each.text) if each.language == "sh" else ():
            if Path(words[0]).name != "funnel-hil" or words[1].startswith("--"):
                continue
            assert words[1] in COMMANDS
            # It raises if an option does not exist, or takes another kind of value.
            arguments = [word for word in words[2:] if word != "&"]
            LazyCommand(words[1]).load().make_context(words[1], join_arguments(arguments))
    for key in re.findall(r"--set '?([a-z_][\w.]*)=", page.read_text()):
        assert key in KEYS or key.startswith(("controller.gains.", "dotted.key")), key


@pytest.mark.parametrize("page", OUTSIDE, ids=name_of)
def test_links_and_paths_of_a_readme_exist(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\((?!https?:)([^)#]*)[^)]*\)", text):
        assert (page.parent / target).exists(), target
    for path in re.findall(r"`([\w/]+/(?:[\w.]+\.(?:py|md|yaml))?)`", text):
        is_there = any((folder / path).exists() for folder in (page.parent, ROOT))
        assert is_there or "NAME" in path, path


def test_start_page_leads_to_every_page():
    start = (DOCS / "index.md").read_text()
    shown, _, _ = start.partition("```{toctree}")
    for page in [*PAGES, *DOCS.rglob("*.ipynb")]:
        name = str(page.relative_to(DOCS).with_suffix(""))
        assert name == "index" or name in shown, f"{name} is not on the start page"


def test_readmes_are_short():
    readme = (ROOT / "README.md").read_text()
    assert len(readme.splitlines()) <= 180
    assert len(readme.split()) <= 1200
    for page in ROOMS:
        assert len(page.read_text().splitlines()) <= 60, page


def test_contributing_names_the_table_of_each_kind_of_extension():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    groups = (DOCS / "how-to/packages.md").read_text()
    found = {
        name: kind
        for room in ("bus_schema", "controller", "plant_emulator", "deploy")
        for file in (ROOT / room).rglob("*.py")
        for name, kind in re.findall(
            r'^(\w+): Registry\[.*\] = Registry\(\s*"(\w+)"', file.read_text(), re.MULTILINE
        )
    }
    assert {"LAWS", "INTERFACES", "LINK_KINDS"} <= set(found)
    for name, kind in found.items():
        assert f"`{name}`" in text, name
        assert f"`funnel_hil.{kind}`" in groups, kind
