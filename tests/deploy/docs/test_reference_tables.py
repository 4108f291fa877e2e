"""The tables of the reference: complete, up to date, and readable without building the site."""

from __future__ import annotations

import re

import pytest

import funnel_hil
from deploy.docs import generated_reference
from deploy.scenario.definition import ScenarioConfiguration
from tests.deploy.docs.pages import DOCS, PAGES
from tests.deploy.docs.test_pages import keys_of
from tests.warm_process import ROOT

REFERENCE = sorted(
    page for page in (DOCS / "reference").glob("*.md") if "<!-- generated:" in page.read_text()
)


@pytest.mark.parametrize("page", REFERENCE, ids=lambda page: page.stem)
def test_tables_in_git_are_what_the_code_says(page):
    command = "python -m deploy.docs.generated_reference"
    text = page.read_text()
    assert generated_reference.up_to_date(text) == text, f"{page.name} is old: run {command}"


def test_each_table_is_on_one_page():
    found = [
        name for page in REFERENCE for name in re.findall(r"generated: (\w+)", page.read_text())
    ]
    assert sorted(found) == sorted(generated_reference.TABLES)


def test_changed_table_is_noticed():
    page = DOCS / "reference" / "results.md"
    edited = page.read_text().replace("`tracking.settling_bound_s`", "`tracking.settling_s`")
    assert generated_reference.up_to_date(edited) == page.read_text() != edited


def test_reference_has_each_key_of_a_scenario():
    text = (DOCS / "reference" / "scenario.md").read_text()
    for key in keys_of(ScenarioConfiguration):
        name = key.rpartition(".")[2]
        assert f"| `{name}` |" in text or f"[`{name}`](#" in text, key


@pytest.mark.parametrize(
    ("page", "content"),
    [
        ("commands", "--require-bounds"),
        ("commands", "funnel-hil keys init"),
        ("results", "tracking.settling_bound_s"),
        ("results", "uplink_delay_p99_9_ms"),
        ("results", "`tip_error_mm.rms` | mm |"),
        ("topics", "float64[] sliding_variable"),
        ("topics", "robot_description"),
        ("scenario", "log_uniform"),
        ("python", "simulate(scenario, changes, law)"),
    ],
)
def test_reference_is_readable_in_the_repository(page, content):
    assert content in (DOCS / "reference" / f"{page}.md").read_text()


def test_no_table_depends_on_this_machine():
    for page in REFERENCE:
        assert str(ROOT) not in page.read_text()


def headings(text):
    """Anchors of headings by GitHub's rule: no punctuation, lower case, dashes for spaces."""
    for heading in re.findall(r"^#+ (.*)", text, re.MULTILINE):
        yield re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_headings_of_the_reference(page):
    links = re.findall(r"\]\(([\w./-]*)#([^)]+)\)", page.read_text())
    for target, anchor in links:
        file = (page.parent / target).resolve() if target else page
        if file in REFERENCE:
            assert anchor in headings(file.read_text()), f"{target}#{anchor}"


def test_reference_describes_what_sections_share_only_once():
    text = (DOCS / "reference" / "scenario.md").read_text()
    for key in ("adaptation_rate", "delayed_node_width", "hold_on"):
        assert text.count(f"| `{key}` |") == 1, key
    (adaptive,) = re.findall(
        r"## controller.gains.fixed_time_adaptive\n(.*?)\n## ", text, re.DOTALL
    )
    assert "`adaptation_rate`" in adaptive
    text = (DOCS / "reference" / "commands.md").read_text()
    assert text.count("| `--set KEY=VALUE` |") == 1
    (margin,) = re.findall(r"## funnel-hil margin\n(.*?)\n## ", text, re.DOTALL)
    assert "`--set`" in margin


def test_links_to_sections_of_the_same_page_lead_to_headings():
    for page in REFERENCE:
        text = page.read_text()
        anchors = set(headings(text))
        assert set(re.findall(r"\]\(#([^)]+)\)", text)) <= anchors, page.name


def test_page_of_the_python_api_documents_each_public_name():
    text = (DOCS / "reference" / "python.md").read_text()
    (members,) = re.findall(r":members: (.*)", text)
    assert set(members.split(", ")) == set(funnel_hil.__all__)
