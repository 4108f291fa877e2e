"""Margins are those of the worst start and seed, in any order of the workers' rows."""

from __future__ import annotations

import json
import re

import pytest

from controller.laws import COMPARED_LAWS
from deploy.reports.studies.results import write_study
from deploy.reports.tables import as_markdown
from deploy.scenario.yaml_files import find_yaml, read_yaml, validated
from deploy.studies.margin.command import MarginOptions, definition_with
from deploy.studies.margin.margin import Margin, MarginDefinition
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.sentences import margin_sentences
from deploy.studies.margin.tables import margins_by_law
from deploy.study.definition import SHIPPED, definition_in
from deploy.study.execution.folder import create_folder
from deploy.study.margin_search import MarginSearch, Steps
from tests.deploy.own_laws import own_law
from tests.deploy.study.studies import NOISE, Here, case_of, conduct, limits, made_up, margin_of
from tests.one_joint import pd_setup


def test_margins_are_those_of_the_worst_start_and_seed(tmp_path):
    margin = margin_of(exhaustive=True)
    whole, folder = conduct(margin, tmp_path / "out", Here(limits, seed=5))
    assert whole
    summary = margin.summary(folder.rows)
    assert [case["margin"] for case in summary["cases"]] == [3.0, 7.0]
    assert [case["first_failure"] for case in summary["cases"]] == [3.5, 7.5]
    assert margin.expected == len(folder.rows)
    probe = next(probe for probe in summary["cases"][1]["probes"] if probe["value"] == 8.0)
    assert not probe["held"]
    # Of the 4 runs at 8 ms, the two from the second start are outside at 1 % of their ticks.
    assert probe["violation_fraction"] == {"mean": 0.005, "lowest": 0.0, "highest": 0.01}
    assert (probe["runs"], probe["runs_kept"]) == (4, 2)


def test_study_file_of_results_is_a_definition(tmp_path):
    file = create_folder(margin_of(laws=["pid"]), tmp_path / "out") / "study.yaml"
    assert definition_in(file)["laws"] == ["pid"]
    Margin(definition_in(file), file)


@pytest.mark.parametrize(("offset", "starts"), [(0.0, 1), (0.01, 3)])
def test_identical_starts_run_once(offset, starts, tmp_path):
    """Without an initial offset, every factor on it is the same start."""
    given = {"robot.initial_offset_rad": offset, **NOISE}
    margin = margin_of(laws=["pid"], offsets=[1, -0.5, 0.3], set=given, exhaustive=True)
    _, folder = conduct(margin, tmp_path / "out", Here(made_up))
    summary = margin.summary(folder.rows)
    probes = summary["cases"][0]["probes"]
    assert {probe["runs"] for probe in probes} == {starts * 2}  # with two seeds each
    text = margin.conditions(summary, {})["starts"]
    once = "; once on paper_arm, where the initial offset is 0" if starts == 1 else ""
    assert text == f"initial offset × 1, -0.5, 0.3{once}"


def test_a_run_that_fails_does_not_hold(tmp_path):
    margin = margin_of(laws=["pid"])
    broken = Here(lambda run: made_up(run, error="it broke" if run.columns["value"] > 2 else None))
    _, folder = conduct(margin, tmp_path / "out", broken)
    assert margin.summary(folder.rows)["cases"][0]["margin"] == 2.0


UNLUCKY = """if not hasattr(self, "has_begun"):
    from pathlib import Path
    self.has_begun = True
    runs = Path({runs!r})
    runs.write_text(runs.read_text() + "x")
    if len(runs.read_text()) == {fails}:
        raise MemoryError"""


@pytest.mark.parametrize("fails", [1, 3])
def test_a_run_that_fails_by_accident_leaves_the_margin_open(
    funnel_hil, tmp_path, import_folder, fails
):
    (runs := tmp_path / "runs.txt").write_text("")
    law = own_law(tmp_path, UNLUCKY.format(runs=str(runs), fails=fails), "unlucky")
    out = tmp_path / "out"
    words = ["margin", "--laws", law, "--limit", "2", "--resolution", "1"]
    words += ["--seeds", "1", "--offsets", "0.1", "--set", "duration_s=0.02"]
    words += ["--set", "metrics.from_s=0", "--workers", "1", "--out", out]
    output = funnel_hil.output(*words, code=1)
    assert "repeat the same command to continue" in output
    assert "1 of" in output
    assert "MemoryError" in output
    (case,) = json.loads((out / "summary.json").read_text())["cases"]
    assert (case["completed"], case["first_failure"]) == (False, None)
    assert case["probes"][-1]["held"] is None
    funnel_hil.output(*words)  # tries it again, and nothing else
    (case,) = json.loads((out / "summary.json").read_text())["cases"]
    assert (case["completed"], case["margin"]) == (True, 2.0)
    assert len(runs.read_text()) == 3 + 1 + (1 if fails == 1 else 2)  # theory asks it too


def test_margins_as_a_table_for_documents(tmp_path):
    margin = margin_of(limit=8)
    _, folder = conduct(margin, tmp_path / "out", Here(lambda run: made_up(run) | {
        "verdict": "lost" if "pid" in str(run.overrides) else "kept"}))  # fmt: skip
    assert as_markdown(
        margins_by_law(MarginResult.model_validate(margin.summary(folder.rows)))
    ).splitlines() == [
        "| law | paper_arm |",
        "| --- | --- |",
        "| `pid` | none |",
        "| `smc` | ≥ 8 ms |",
        "| held-arm ceiling | 123 ms |",
    ]


def test_report_judges_the_rows_of_a_study_again(funnel_hil, tmp_path):
    margin = margin_of()
    path = create_folder(margin, tmp_path / "out")
    conduct(margin, path, Here(limits))
    output = funnel_hil.output("report", path)
    assert "7 ms" in output
    assert json.loads((path / "summary.json").read_text())["cases"][0]["margin"] == 3.0
    assert "| `smc` | 7 ms |" in (path / "table.md").read_text()
    page = (path / "report.html").read_text(encoding="utf-8")
    assert all(f'id="{name}-paper_arm"' in page for name in ("margins", "outside", "rms"))


def test_report_keeps_the_summary_of_a_search_that_tried_fewer_values(funnel_hil, tmp_path, capfd):
    """As an older version did, which left a gap as wide as it came."""
    margin = margin_of(laws=["smc"])
    for search in margin.searches:
        search.parts = 1
    path = create_folder(margin, tmp_path / "out")
    _, folder = conduct(margin, path, Here(limits))
    write_study(margin, folder)
    before = json.loads((path / "summary.json").read_text())
    assert (before["completed"], before["cases"][0]["quoted"]) == (True, 7.0)
    output = funnel_hil.output("report", path) + capfd.readouterr().err
    assert "made by another search: this is the summary of before" in output
    assert json.loads((path / "summary.json").read_text()) == before


def test_table_is_readable_without_a_terminal_width(funnel_hil, tmp_path):
    margin = margin_of(laws=["fixed_time_model_based"], compensation=[False, True], limit=128)
    path = create_folder(margin, tmp_path / "out")
    conduct(margin, path, Here(lambda run: made_up(run, violation_fraction=1 / 8000)))
    _, output = funnel_hil("report", path)
    (row,) = (line for line in output.splitlines() if re.search(r"paper_arm +\S+ +without ", line))
    law = "fixed_time_model_based"
    assert row.split()[:6] == ["paper_arm", law, "without", "none", "0", "ms"]
    assert "…" not in output


def test_the_shipped_study_asks_for_all_laws_on_both_arms_in_all_settings():
    path = find_yaml("delay_margin", SHIPPED)
    definition = validated(read_yaml(path), MarginDefinition, path)
    assert definition.laws == COMPARED_LAWS
    assert definition.scenarios == ["paper_arm", "iiwa"]
    assert definition.compensation == [False, True]
    assert definition.drive_feedback == [False, True]
    assert definition.duration_s is None  # the scenarios' own


@pytest.mark.parametrize(
    ("values", "options", "duration_s", "fixed"),
    [
        ({"duration_s": 8}, {"overrides": ["duration_s=20"]}, None, {"duration_s": 20}),
        ({"duration_s": 8}, {"duration": 12.0}, 12.0, {}),
        ({"set": {"duration_s": 8}}, {"duration": 12.0}, 12.0, {}),
        ({"set": {"duration_s": 8, "seed": 2}}, {}, None, {"duration_s": 8, "seed": 2}),
    ],
)
def test_options_take_precedence_over_a_study(values, options, duration_s, fixed):
    found = definition_with(MarginOptions(**options), values)
    assert found.get("duration_s") == duration_s
    assert found["set"] == fixed


def found(holds, first=2, limit=256):
    """A finished search and the values it probed, in order."""
    search, probed = MarginSearch(Steps(0.0, 1.0, first, limit)), []
    while (value := search.next()) is not None:
        probed.append(value)
        search.outcomes[value] = holds(value)
    return search, probed


@pytest.mark.parametrize("margin", [0, 1, 2, 7, 31, 32, 100, 255])
def test_the_largest_value_that_holds_is_found_to_one_step(margin):
    search, probed = found(lambda value: value <= margin)
    assert search.margin == margin
    assert search.first_failure == margin + 1
    assert search.held_again == []
    assert len(set(probed)) == len(probed)


def test_values_are_doubled_until_one_fails_then_halved_then_looked_at_between_and_beyond():
    _, probed = found(lambda value: value <= 9)
    # 16 fails; 12 and 10 fail, 9 holds on the way down; from 4 to 8 is more than an eighth of 9;
    # beyond the first failure, 10: 15 and 20.
    assert probed == [0, 2, 4, 8, 16, 12, 10, 9, 6, 15, 20]


def test_a_window_of_instability_wider_than_an_eighth_of_the_margin_is_found():
    for start in range(12, 80):  # 100 holds, so the doubling steps over it
        search, _ = found(lambda value: not start <= value < start + 14, limit=100)  # noqa: B023
        assert search.first_failure == start
        assert search.margin == start - 1
    # Up to the margin, no gap is wider than an eighth of it.
    search, _ = found(lambda _: True, limit=100)
    low, high = search.widest_gap
    assert high - low <= 13


def test_the_search_goes_first_where_theory_expects_the_loss():
    search, probed = MarginSearch(Steps(0.0, 0.5, 2, 256), hints=[4, 5], parts=1), []
    while (value := search.next()) is not None:
        probed.append(value)
        search.outcomes[value] = value not in (5, 17, 18)
    assert probed == [0, 4, 5, 8, 10]
    assert (search.margin, search.first_failure) == (4, 5)


@pytest.mark.parametrize(
    ("holds", "last", "margin", "first_failure"), [(False, 0, None, 0), (True, 50, 50, None)]
)
def test_search_ends_at_a_failing_zero_or_at_the_limit(holds, last, margin, first_failure):
    search, probed = found(lambda _: holds, limit=50)
    assert (max(probed), search.margin, search.first_failure) == (last, margin, first_failure)


def test_larger_values_that_hold_again_are_reported_and_do_not_count():
    search, _ = found(lambda value: value <= 9 or value == 15)
    assert search.margin == 9
    assert search.held_again == [15]


@pytest.mark.parametrize("margin", [0, 3, 20, 200])
def test_what_is_left_is_never_too_much_once_a_value_has_failed(margin):
    search = MarginSearch(Steps(0.0, 1.0, 2, 256))
    probed = 0
    expected = None
    while (value := search.next()) is not None:
        if search.first_failure is not None and expected is None:
            expected = probed + search.probes_left
        search.outcomes[value] = value <= margin
        probed += 1
    assert search.probes_left == 0
    assert expected is None or probed <= expected


@pytest.mark.parametrize(("law", "is_said"), [("smc", True), ("pid", False)])
def test_growth_that_runs_are_too_short_to_show_is_not_tested_unless_theory_knows(
    law, is_said, tmp_path
):
    """Runs of 6 s, of which two periods must fit into the last half."""
    study = margin_of(laws=[law], seeds=1, offsets=[1.0], limit=4, running=[False])
    workers = Here(lambda run: made_up(run, not_tested_below_hz=2.0 / 3.0))
    _, folder = conduct(study, tmp_path / "out", workers)
    said = [
        each
        for each in margin_sentences(MarginResult.model_validate(study.summary(folder.rows)))
        if "too short" in each
    ]
    assert bool(said) is is_said
    assert all("an oscillation below 0.67 Hz" in each for each in said)


def test_a_loop_lost_without_a_delay_is_named_with_its_pole_and_no_remedy(tmp_path):
    """J s² + D s + K = 0 with J = 0.5, D = 5, K = -50 has the root 6.18/s."""
    pd_setup(tmp_path, 0.5, -50.0, 5.0, offset_rad=1e-3)
    search = {
        "scenarios": [str(tmp_path / "one.yaml")], "laws": ["tests.joint_laws:Feedback"],
        "set": {"duration_s": 2.0}, "what_helps": True,
    }  # fmt: skip
    study = Margin(search, tmp_path)
    _, folder = conduct(study, tmp_path / "out", Here())
    summary = study.summary(folder.rows)
    assert case_of(study, folder)["what_helps"] is None
    assert any(
        "unstable, j0, even at the smallest value tried; in theory unstable without a delay: it"
        " grows by 6.18/s without swinging" in each
        for each in margin_sentences(MarginResult.model_validate(summary))
    )
