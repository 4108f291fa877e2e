from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import pytest

from bus_schema.messages.run_event import EventKind, RunEvent
from deploy.comparison.comparison import Comparison, LawRun
from deploy.comparison.settling import SettlingTest, Start
from deploy.reports.figures.arm.end_effector import tip_paths
from deploy.reports.figures.errors import error_envelopes, errors_in_funnel
from deploy.reports.figures.laws import joint_bars
from deploy.reports.figures.studies.settling import settling, settling_from_afar
from deploy.reports.figures.torque import torque_spectra
from deploy.reports.quantities import BY_LAW, RMS_ERROR
from deploy.reports.studies import compare_report
from deploy.reports.studies.compare_report import write_comparison_report
from deploy.reports.studies.compare_tables import joint_table, verdict_on_laws, verdict_table
from deploy.runs.judging.metrics import summarise
from deploy.runs.judging.verdict import Verdict, with_verdict
from deploy.runs.run_data import build_run_data
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup

FIGURES = ("rms", "settling", "settling-from-afar", "errors", "errors-first-second",
           "error-envelopes", "tip-paths", "tip-errors", "torques", "total-variation",
           "chatter-share", "torque-spectra", "network-output")  # fmt: skip
HOSTILE = "</script><script>alert(1)</script>"


def law_run(law):
    data = simulate(
        load_setup("paper_arm", ["duration_s=1.2", "metrics.from_s=0.5", f"controller.law={law}"])
    ).data()
    return LawRun(law, data, summarise(data))


@pytest.fixture(scope="module")
def comparison():
    runs = [law_run("fixed_time_neural"), law_run("pid")]
    rows = [Start([0.1] * 3, 0.4, bounds_kept=True),
            Start([1.0] * 3, None, bounds_kept=False)]  # fmt: skip
    bounds = (2.5, None)
    return Comparison(
        runs, [SettlingTest(run.law, bound, rows) for run, bound in zip(runs, bounds, strict=True)]
    )


@pytest.fixture(scope="module")
def page_of(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    pages = []

    def write(comparison):
        """The report; that of a comparison is written once."""
        for subject, page in pages:
            if subject is comparison:
                return page
        write_comparison_report(comparison, path, {"law": HOSTILE})
        pages.append((comparison, path.read_text(encoding="utf-8")))
        return pages[-1][1]

    return write


def with_bounds(run, *, kept, margin=-1.0):
    bounds = {"kept": kept, "violation_fraction": 0.0 if kept else 0.25,
              "first_violation_s": None if kept else 0.125,
              "margin_min": 0.5 if kept else margin}  # fmt: skip
    summary = {**run.summary, "bounds": bounds}
    return replace(run, summary=with_verdict(summary, Verdict.KEPT if kept else Verdict.LOST))


def faulted(run):
    summary = {**run.summary, "faults": ["it broke"]}
    return replace(run, summary=with_verdict(summary, Verdict.FAULTED))


def empty(run):
    event = RunEvent(0, "controller", EventKind.FAULT, "it broke")
    data = build_run_data(
        run.data.setup, {"run_events": [event.encode()]}, clock="virtual", link="in_process"
    )
    return LawRun(run.law, data, summarise(data))


def test_a_report_has_every_figure_with_a_caption(comparison, page_of):
    page = page_of(comparison)
    for name in FIGURES:
        assert f'<figure class="card" id="{name}">' in page
    assert page.count("<figcaption>") == len(FIGURES)


def test_the_page_needs_nothing_from_outside(comparison, page_of):
    page = page_of(comparison)
    assert not re.search(r"https?://|@import|url\(", page)
    assert "default-src 'none'" in page


def test_figures_over_time_share_an_instant(comparison, page_of):
    page = page_of(comparison)
    marked = re.findall(r'data-plot="([\w-]+)-plot" data-time="">', page)
    assert {"errors", "errors-first-second", "error-envelopes", "tip-errors"} <= set(marked)
    assert "torques" not in marked  # its laws stand side by side
    assert re.search(r'type="range" min="0" max="1\.2\d*"', page)


def test_every_law_is_in_every_figure_in_its_own_colour(comparison):
    figures = [partial(joint_bars, quantity=RMS_ERROR), errors_in_funnel, tip_paths,
               error_envelopes, torque_spectra]  # fmt: skip
    colours = {}
    for draw in figures:
        for trace in draw(comparison).data:
            if trace.name in ("fixed_time_neural", "pid"):
                style = trace.marker if trace.type == "bar" else trace.line
                colours.setdefault(trace.name, set()).add(style.color)
    assert {law: len(used) for law, used in colours.items()} == {"fixed_time_neural": 1, "pid": 1}
    assert len(set.union(*colours.values())) == 2


@pytest.mark.parametrize(
    ("kept", "level", "headline"),
    [
        ((True, True), "good", "All 2 laws kept their bounds"),
        ((True, False), "mixed", "1 of 2 laws kept their bounds"),
        ((False, False), "bad", "No law kept its bounds"),
    ],
)
def test_the_headline_counts_who_kept_the_bounds(comparison, kept, level, headline):
    runs = [with_bounds(run, kept=k) for run, k in zip(comparison.runs, kept, strict=True)]
    verdict = verdict_on_laws(Comparison(runs))
    assert (verdict.level, verdict.headline) == (level, headline)


def test_a_law_that_faulted_is_neither_kept_nor_best(comparison, page_of, monkeypatch):
    monkeypatch.setattr(compare_report, "PANELS", compare_report.PANELS[:1])
    first, second = (with_bounds(run, kept=True) for run in comparison.runs)
    broken = Comparison([faulted(first), second])
    verdict = verdict_on_laws(broken)
    assert verdict.level == "broken"
    assert verdict.headline == "1 of 2 laws kept their bounds, 1 did not finish"
    assert "fixed_time_neural: it broke" in verdict.reasons
    assert '<td class="best">' not in page_of(broken)


def test_a_law_that_left_its_funnel_is_green_in_no_column_and_wins_nothing(comparison, page_of):
    first, second = comparison.runs
    mixed = Comparison(
        [with_bounds(first, kept=False, margin=-14.1), with_bounds(second, kept=True)]
    )
    rows = [row for table in tables_of(mixed) for row in table.cells if row[0].value == first.law]
    assert not {cell.status for row in rows for cell in row} & {"best", "good"}
    assert not any(first.law in text for text in verdict_on_laws(mixed).reasons if "east" in text)


def test_an_error_far_outside_is_told_as_a_multiple_of_its_bound(comparison):
    far, near = (with_bounds(run, kept=False, margin=margin)
                 for run, margin in zip(comparison.runs, (-14.14, -0.2), strict=True))  # fmt: skip
    verdict, *_ = tables_of(Comparison([far, near]))
    place = [column.heading for column in verdict.columns].index("Smallest margin")
    texts = [row[place].text for row in verdict.cells]
    assert texts == ["error 15.1 × bound", "-20 %"]
    assert (
        verdict_on_laws(Comparison([far, near])).reasons[0].endswith("at most 15.1 times its bound")
    )


def tables_of(comparison):
    return [verdict_table(comparison), *(joint_table(comparison, q) for q in BY_LAW)]


def test_the_most_precise_law_is_named_joint_by_joint(comparison):
    runs = []
    for law, rms in zip(comparison.runs, ([1e-3, 4e-3, 1e-3], [2e-3, 2e-3, 4e-3]), strict=True):
        run = with_bounds(law, kept=True)
        tracking = {**run.summary["tracking"], "rms_rad": rms}
        runs.append(replace(run, summary={**run.summary, "tracking": tracking}))
    sentences = [reason for reason in verdict_on_laws(Comparison(runs)).reasons if "RMS" in reason]
    assert sentences == [
        "Smallest RMS error: fixed_time_neural on base_yaw and elbow, at most 0.5 × the next best;"
        " pid on shoulder, at most 0.5 × the next best."
    ]


def test_a_run_without_data_leaves_the_others_in_the_report(comparison, page_of):
    page = page_of(Comparison([empty(comparison.runs[0]), comparison.runs[1]]))
    assert 'id="errors"' in page
    assert 'id="network-output"' not in page
    assert "it broke" in page


def test_a_comparison_of_nothing_but_empty_runs_has_a_report(comparison, page_of):
    page = page_of(Comparison([empty(run) for run in comparison.runs]))
    assert "Nothing was recorded that could be drawn" in page


def test_settling_bounds_are_drawn_for_the_laws_that_have_one(comparison):
    first, second = comparison.runs
    tracking = {**first.summary["tracking"], "settling_bound_s": 2.5}
    bounded = replace(first, summary={**first.summary, "tracking": tracking})
    tracking = {**second.summary["tracking"], "settling_bound_s": None}
    unbounded = replace(second, summary={**second.summary, "tracking": tracking})
    names = [t.name for t in settling(Comparison([bounded, unbounded])).data]
    assert [name for name in names if name.startswith("bound")] == ["bound of fixed_time_neural"]


def test_starts_from_near_and_far_are_drawn_against_the_bound_of_the_law_that_has_one(comparison):
    figure = settling_from_afar(comparison)
    traces = {trace.name: trace for trace in figure.data}
    assert set(traces) == {"fixed_time_neural", "pid", "bound of fixed_time_neural"}
    starts = traces["fixed_time_neural"]
    assert starts.x == (0.1, 1.0)
    assert starts.marker.symbol == ("circle", "x-thin-open")
    assert starts.y == (0.4, 1.2)  # the second did not settle in the 1.2 s that it was watched
    assert traces["bound of fixed_time_neural"].y == (2.5, 2.5)
    assert settling_from_afar(Comparison(comparison.runs)) is None


def test_texts_from_a_run_are_shown_and_never_executed(comparison, page_of):
    runs = [replace(faulted(run), law=run.law + HOSTILE) for run in comparison.runs]
    page = page_of(Comparison(runs))
    assert "<script>alert" not in page


@pytest.mark.parametrize(
    ("values", "largest"), [([1e-3, 3e-3, 2e-3], 3.0), ([1e-3, None], None), (None, None)]
)
def test_the_largest_of_all_joints_is_unknown_if_one_is(values, largest):
    summary = {"tracking": {"rms_rad": values, "joint_names": ["a", "b", "c"]}}
    assert RMS_ERROR.of_worst_joint(summary) == largest
