from __future__ import annotations

import io
import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from deploy.reports.figures.study_figures import DrawnStudy
from deploy.reports.html import write_page
from deploy.reports.studies.case_sentences import saved_runs
from deploy.reports.studies.results import study_page
from deploy.reports.terminal import print_page
from deploy.studies.margin.figures import margin_bars
from deploy.studies.margin.page import margin_page
from deploy.studies.margin.result import MarginResult
from deploy.studies.sweep.page import sweep_page
from tests.deploy.reports.page_order import assert_shows_before_it_tells

HOSTILE = "</script><script>alert(1)</script>"
FOLDER = SimpleNamespace(
    rows_file=Path("rows.parquet"), rerun_command=lambda point: f"funnel-hil simulate {point}.yaml"
)


def spread(mean):
    return {"mean": mean, "lowest": mean / 2, "highest": 2 * mean}


def runs(fraction, **values):
    spreads = {"violation_fraction": spread(fraction), "worst_rms_rad": spread(2e-3)}
    return {"runs": 2, "runs_kept": 2 * (fraction == 0), "runs_failed": 0, **spreads, **values}


@pytest.fixture
def sweep():
    values = [[float(delay), f"law{HOSTILE}"] for delay in range(3)]
    return {
        "kind": "sweep", "name": "small", "scenario": HOSTILE, "completed": False, "runs": 6,
        "runs_failed": 1, "commonest_error": HOSTILE, "seeds": [4, 5], "plants": None,
        "conditions": {"law": HOSTILE},
        "axes": [{"keys": ["link.uplink.delay_ms", HOSTILE], "values": [0.0, 1.0, 2.0]},
                 {"keys": ["controller.law"], "values": [f"law{HOSTILE}"]}],
        "points": [runs(0.01 * index, point=f"0000{index}", worst_point=f"0000{index}",
                        values=point)
                   for index, point in enumerate(values)],
    }  # fmt: skip


@pytest.fixture
def margin():
    probes = [runs(0.0, value=4.0, worst_point="a", points=["a"]),
              runs(0.25, value=8.0, worst_point="b", points=["b", "c"])]  # fmt: skip
    case = {
        "arm": "my_arm",
        "law": "pid",
        "compensation": True,
        "drive_feedback": None,
        "running": False,
        "growth": 1,
        "held_arm_ceiling_ms": 65.9,
        "margin": 4.0,
        "first_failure": 8.0,
        "held_again": [12.0],
        "completed": True,
        "probes": probes,
    }
    return {
        "kind": "margin", "name": "m", "quantity": "delay", "title": "round trip", "unit": "ms",
        "resolution": 0.5, "limit": 128.0, "completed": True, "runs": 6, "runs_failed": 0,
        "commonest_error": None,
        "conditions": {"law": "pid"},
        "seeds": [1], "offsets": [1.0, -0.5], "duration_s": {"my_arm": 8.0}, "cases": [case],
    }  # fmt: skip


@pytest.fixture
def page_of(tmp_path):
    def write(summary):
        write_page(tmp_path / "report.html", study_page(summary, FOLDER))
        return (tmp_path / "report.html").read_text(encoding="utf-8")

    return write


def shown(summary):
    console = Console(file=io.StringIO(), width=80)
    print_page(console, study_page(summary, FOLDER))
    return console.file.getvalue()


def test_reports_of_studies_show_one_figure_before_they_tell(sweep, margin, page_of):
    for summary in (sweep, margin):
        page = page_of(summary)
        assert_shows_before_it_tells(page)
        assert page[: page.index("<h2>")].count("<figure") == 1


def test_the_figure_of_a_sweep_is_of_what_is_not_zero_everywhere(sweep):
    assert next(iter(sweep_page(DrawnStudy(sweep, str)).panels())).id == "curve-violation_fraction"
    sweep["points"] = [{**each, **runs(0.0)} for each in sweep["points"]]
    assert next(iter(sweep_page(DrawnStudy(sweep, str)).panels())).id == "curve-worst_rms_rad"


def test_the_lede_of_a_sweep_names_all_that_was_swept(sweep):
    study = DrawnStudy(sweep, str)
    lede = sweep_page(study).verdict.reasons[0]
    assert lede.startswith("Swept: ")
    assert all(", ".join(axis["keys"]) in lede for axis in sweep["axes"])


def test_planned_runs_that_were_not_needed_are_in_two_sentences():
    saved = {"runs_planned": 40, "runs_ended_early": 0, "planned_s": 10.0, "simulated_s": 7.0}
    case = {"arm": "a", "law": "pid", "compensation": None, "drive_feedback": None,
            "running": False}  # fmt: skip
    values = {"unit": "ms", "runs": 28, "saved": saved, "cases": [case]}
    assert saved_runs(MarginResult.model_validate(values)) == [
        "28 of 40 planned runs decided the result. They took 70 % of the planned simulated time."
    ]
    saved["runs_ended_early"] = 3
    (sentence,) = saved_runs(MarginResult.model_validate(values))
    assert "decided the result; 3 of them ended at their loss." in sentence


@pytest.mark.parametrize(
    ("key", "values", "mode"),
    [
        ("link.uplink.delay_ms", [0.0, 1.0, 2.0], "lines+markers"),
        ("link.uplink.trace.start_s", [0.0, 1.0, 2.0], "markers"),
        ("link.uplink.trace.file", ["5g", "vpn", "wifi_idle"], "markers"),
    ],
)
def test_lines_join_sequences_but_no_windows_and_no_names(sweep, key, values, mode):
    sweep["axes"] = [{"keys": [key], "values": values}]
    for point, value in zip(sweep["points"], values, strict=True):
        point["values"] = [value]
    study = DrawnStudy(sweep, str)
    figure = next(iter(sweep_page(study).panels())).draw(study)
    assert figure.data[-1].mode == mode
    assert (figure.data[-1].error_y.array is not None) == (mode == "markers")


def test_the_headline_of_margins_has_those_of_the_table(margin):
    first = margin["cases"][0]
    first["model_scale"] = 1.0
    margin["cases"] += [{**first, "law": "smc", "margin": 8.0, "first_failure": None},
                        {**first, "compensation": False, "margin": None}]  # fmt: skip
    page = margin_page(DrawnStudy(margin, str))
    assert page.verdict.headline == (
        "Largest round trip kept by smc, the best of 2 laws, on my_arm, with an exact model:"
        " ≥ 8 ms with compensation, none without compensation"
    )
    column = [each.heading for each in page.tables[0].columns].index("Margin to quote")
    assert {row[column].text for row in page.tables[0].cells} == {"4 ms", "≥ 8 ms", "none"}


def test_report_shows_the_theory_of_an_older_version(margin, page_of):
    margin["cases"][0]["theory"] = {"constant_ms": 6.5, "any_pattern_ms": 2.5, "joint": "elbow"}
    sentence = "stable with every constant round trip up to 6.5 ms, and with every varying"
    assert sentence in page_of(margin)
    assert sentence in " ".join(shown(margin).split())


def test_texts_of_a_sweep_are_shown_and_never_executed(sweep, page_of):
    page = page_of(sweep)
    assert "<script>alert" not in page
    assert page.count("&lt;script&gt;alert(1)") >= 5


def test_points_of_a_figure_carry_the_command_that_runs_them_again(margin, page_of):
    page = page_of(margin)
    bars = json.loads(re.search(r'data-plot="margins-my_arm-plot">(.*?)</script>', page)[1])
    assert bars["data"][0]["customdata"] == ["funnel-hil simulate b.yaml"]
    assert page.count("<output>Click on a point") == 3


def test_report_names_the_seeds_of_every_run(sweep, margin, page_of):
    assert "have seed 4; add --set seed=5 and so on for the others." in page_of(sweep)
    assert "have seed 1." in page_of(margin)


def test_the_headline_tells_a_running_loop_from_one_that_starts(margin, page_of):
    margin["cases"].append({**margin["cases"][0], "running": True, "margin": 64.0})
    page, text = page_of(margin), " ".join(shown(margin).split())
    for message in (
        "my_arm, a loop that already runs: the largest margin is 64 ms, of pid with compensation.",
        "my_arm: the largest margin is 4 ms, of pid with compensation.",
    ):
        assert message in page
    assert "kept by pid on my_arm: 4 ms with compensation my_arm" in text  # the worse of both


def test_the_headline_names_all_laws_of_the_largest_margin(margin, page_of):
    first = margin["cases"][0]
    first["model_scale"] = 1.0
    margin["cases"] += [{**first, "law": "smc"}, {**first, "law": "tsmc", "compensation": False}]
    text = "the largest margin is 4 ms, of pid and smc with compensation; of tsmc without"
    assert text in page_of(margin)


def test_many_lines_share_a_legend_of_laws_and_settings(margin):
    """Ten entries for eight laws with and without compensation, not sixteen."""
    first, laws = margin["cases"][0], [f"law_{number}" for number in range(8)]
    margin["cases"] = [
        {**first, "law": law, "compensation": has_it} for law in laws for has_it in (False, True)
    ]
    study = DrawnStudy(margin, str)
    lines = next(panel for panel in margin_page(study).panels() if panel.id == "rms-my_arm")
    entries = [trace.name for trace in lines.draw(study).data if trace.showlegend is not False]
    assert entries == [*laws, "without compensation", "with compensation"]


def test_terminal_and_report_tell_the_same_numbers(margin, page_of):
    text, page = shown(margin), page_of(margin)
    for number in ("4 ms", "8 ms", "25"):
        assert f">{number}</td>" in page
        assert number in text.split("─")[-1]
    assert "held again at 12, beyond its first failure" in text
    assert "held again at 12, beyond its first failure" in page


@pytest.mark.parametrize(("compensation", "shown_there"), [(True, True), (None, False)])
def test_margins_without_a_word_on_compensation_have_no_column_of_it(
    margin, page_of, compensation, shown_there
):
    margin["cases"][0]["compensation"] = compensation
    assert ("Compen" in shown(margin)) is shown_there
    assert (">Compensation</th>" in page_of(margin)) is shown_there


def test_a_long_sweep_is_cut_in_the_terminal_only_which_warns(sweep, page_of):
    sweep["points"] = [{**sweep["points"][0], "point": f"{index:05d}"} for index in range(43)]
    assert "3 more rows are in the report" in shown(sweep)
    assert "warning" not in shown(sweep)
    assert "warning: a.key, b.key: none" in shown({**sweep, "without_effect": ["a.key, b.key"]})
    assert page_of(sweep).count('href="scenarios/') == 43


REMEDIES = {
    "no gravity term": "compare pid_gravity, which has a gravity term.",
    "robot's lag": "reads the reference ahead by that lag",
}


@pytest.mark.parametrize(("margin_ms", "reason"), [
    (None, "no gravity term"), (None, "robot's lag"), (None, "growing"), (4.0, "no gravity term"),
])  # fmt: skip
def test_what_helps_a_case_that_is_lost_at_once_is_beside_its_row(margin, margin_ms, reason):
    (case,) = margin["cases"]
    lost = runs(0.25, value=0.0, points=["b"], losses={reason: 2}, loss_joints={"shoulder": 2})
    case |= {"margin": margin_ms, "first_failure": 0.0, "probes": [lost]}
    told = " ".join(shown(margin).split())
    begins = f"is lost already at 0 ms ({reason}, shoulder): "
    assert (begins in told) == (margin_ms is None and reason in REMEDIES)
    if begins in told:
        assert REMEDIES[reason] in told.partition(begins)[2]


@pytest.mark.parametrize("is_swept", [True, False])
def test_sweep_names_what_helps_at_the_points_that_a_law_lost(sweep, is_swept):
    lost = [{"no gravity term": 2}, {"no gravity term": 1, "growing": 3}, {"no gravity term": 1}]
    for point, losses in zip(sweep["points"], lost, strict=True):
        point["losses"] = losses
        point["values"][1] = "pid"
    sweep["axes"][1] = {"keys": ["controller.law" if is_swept else "seed"], "values": ["pid"]}
    sweep["conditions"] = {"law": "pid"}
    told = " ".join(shown(sweep).split())
    assert "pid is lost at 2 points (no gravity term): compare pid_gravity, which" in told
    sweep["points"][0]["losses"] = sweep["points"][2]["losses"] = {"growing": 1}
    assert "is lost at" not in shown(sweep)


def test_figure_of_margins_tells_none_from_zero_and_names_the_ceiling(margin):
    (known,) = margin["cases"]
    none, zero = ({**known, "law": law, "quoted": quoted, "quoted_because": "theory"}
                  for law, quoted in (("lost", None), ("slow", 0.0)))  # fmt: skip
    margin["cases"] = [{**known, "held_arm_ceiling_ms": 5.0}, none, zero]
    study = DrawnStudy(margin, FOLDER.rerun_command)
    result = MarginResult.model_validate(margin)
    figure = margin_bars(study, result, result.cases)
    (bars,), (level,) = figure.data, figure.layout.shapes
    assert list(bars.text) == ["4", "none", "0"]
    assert (level.name, level.showlegend) == ("held-arm ceiling", True)
    assert figure.layout.showlegend
    assert not bars.showlegend
