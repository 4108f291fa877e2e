from __future__ import annotations

from functools import partial

import pytest

from bus_schema.messages.run_event import EventKind, RunEvent
from deploy.judge.metrics import RunResult
from deploy.judge.run_data import build_run_data
from deploy.judge.verdict import Verdict
from deploy.reports.figures.joints import error_envelopes, error_in_funnel, torque_spectra
from deploy.reports.figures.several_runs import joint_bars, settling, settling_from_afar
from deploy.reports.figures.space import tip_path
from deploy.reports.html import write_page
from deploy.reports.runs import run_panels
from deploy.reports.runs.run_numbers import BY_LAW, RMS_ERROR, SETTLING_TIME
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.studies.comparison.page import laws_page
from deploy.studies.comparison.sentences import verdict_on_laws
from deploy.studies.comparison.tables import law_table, verdict_table
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.comparison.settling import SettlingTest, Start
from tests.deploy.reports.page_order import assert_shows_before_it_tells
from tests.warm_process import here

FIGURES = ("rms", "settling", "settling-from-afar", "errors", "errors-first-second",
           "error-envelopes", "tip-paths", "tip-errors", "torques", "total-variation",
           "chatter-share", "torque-spectra", "network-output")  # fmt: skip
HOSTILE = "</script><script>alert(1)</script>"


def law_run(law):
    data = simulate(
        load_setup("paper_arm", ["duration_s=1.2", "metrics.from_s=0.5", f"controller.law={law}"])
    ).data()
    return JudgedRun(law, data)


@pytest.fixture(scope="module")
def comparison():
    runs = [law_run("fixed_time_neural"), law_run("pid")]
    rows = [Start([0.1] * 3, 0.4, bounds_kept=True),
            Start([1.0] * 3, None, bounds_kept=False)]  # fmt: skip
    bounds = (2.5, None)
    return ComparedRuns(
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
        write_page(path, laws_page(comparison, {"law": HOSTILE}))
        pages.append((comparison, path.read_text(encoding="utf-8")))
        return pages[-1][1]

    return write


def with_summary(run, summary):
    return JudgedRun(run.law, run.data, RunResult(**summary))


def with_bounds(run, *, kept, margin=-1.0):
    bounds = {**run.summary["bounds"], "kept": kept, "violation_fraction": 0.0 if kept else 0.25,
              "first_violation_s": None if kept else 0.125,
              "margin_min": 0.5 if kept else margin}  # fmt: skip
    summary = {**run.summary, "bounds": bounds}
    verdict = Verdict.KEPT if kept else Verdict.LOST
    return JudgedRun(run.law, run.data, RunResult(**summary).with_verdict(verdict))


def faulted(run):
    summary = {**run.summary, "faults": ["it broke"]}
    return JudgedRun(run.law, run.data, RunResult(**summary).with_verdict(Verdict.FAULTED))


def empty(run):
    event = RunEvent(0, "controller", EventKind.FAULT, "it broke")
    data = build_run_data(
        run.data.setup, {"run_events": [event.encode()]}, clock="virtual", link="in_process"
    )
    return JudgedRun(run.law, data)


def test_a_report_has_every_figure_with_a_caption(comparison, page_of):
    page = page_of(comparison)
    for name in FIGURES:
        assert f'<figure class="card" id="{name}">' in page
    assert page.count("<figcaption>") == len(FIGURES)


def test_a_comparison_shows_before_it_tells(comparison, page_of):
    page = page_of(comparison)
    assert_shows_before_it_tells(page)
    assert page.index('id="errors"') < page.index('id="reasons"') < page.index('id="rms"')


def test_every_law_is_in_every_figure_in_its_own_colour(comparison):
    figures = [partial(joint_bars, quantity=RMS_ERROR), error_in_funnel, tip_path,
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
def test_headline_counts_the_laws_that_kept_their_bounds(comparison, kept, level, headline):
    runs = [with_bounds(run, kept=k) for run, k in zip(comparison.runs, kept, strict=True)]
    verdict = verdict_on_laws(ComparedRuns(runs))
    assert (verdict.level, verdict.headline) == (level, headline)


def test_a_law_that_faulted_is_neither_kept_nor_best(comparison, page_of, monkeypatch):
    monkeypatch.setattr(run_panels, "LAW_PANELS", run_panels.LAW_PANELS[:1])
    first, second = (with_bounds(run, kept=True) for run in comparison.runs)
    broken = ComparedRuns([faulted(first), second])
    verdict = verdict_on_laws(broken)
    assert verdict.level == "broken"
    assert verdict.headline == "1 of 2 laws kept their bounds, 1 did not finish"
    assert "fixed_time_neural: it broke" in verdict.reasons
    assert '<td class="best">' not in page_of(broken)


def test_a_law_that_left_its_funnel_is_green_in_no_column_and_wins_nothing(comparison, page_of):
    first, second = comparison.runs
    mixed = ComparedRuns(
        [with_bounds(first, kept=False, margin=-14.1), with_bounds(second, kept=True)]
    )
    rows = [row for table in tables_of(mixed) for row in table.cells if row[0].value == first.law]
    assert not {cell.status for row in rows for cell in row} & {"best", "good"}
    assert not any(first.law in text for text in verdict_on_laws(mixed).reasons if "east" in text)


def test_error_far_outside_is_reported_as_a_multiple_of_its_bound(comparison):
    far, near = (with_bounds(run, kept=False, margin=margin)
                 for run, margin in zip(comparison.runs, (-14.14, -0.2), strict=True))  # fmt: skip
    verdict, *_ = tables_of(ComparedRuns([far, near]))
    place = [column.heading for column in verdict.columns].index("Smallest margin")
    texts = [row[place].text for row in verdict.cells]
    assert texts == ["error 15.1 × bound", "-20 %"]
    link, _, first, *_ = verdict_on_laws(ComparedRuns([far, near])).reasons
    assert first.endswith("at most 15.1 times its bound (base_yaw at 0.005 s)")
    assert "compared without a link delay" in link


def short_run(law, *settings):
    setup = load_setup("paper_arm", ["duration_s=0.05", f"controller.law={law}", *settings])
    return JudgedRun(law, simulate(setup).data())


def test_comparison_says_at_which_delay_and_with_which_gains():
    laws = ("smc", "fixed_time_adaptive")
    link, gains, *_ = verdict_on_laws(ComparedRuns([short_run(law) for law in laws])).reasons
    assert link == (
        "All laws were compared without a link delay, which says nothing about how much delay each"
        " survives. This compares their margins: funnel-hil margin SCENARIO --laws"
        " smc,fixed_time_adaptive"
    )
    assert gains.startswith("Nothing records whether the scenario's gains of smc were tuned alike.")
    late = ("link.uplink.delay_ms=3", "link.downlink.loss=0.1", "controller.gains.smc=null")
    link, gains, *_ = verdict_on_laws(ComparedRuns([short_run("smc", *late)])).reasons
    assert link.startswith("All laws were compared on the same link (round trip 3 ms, losses).")
    assert gains.startswith("Their gains follow from the arm's inertia and were not tuned.")


def test_commands_that_compare_margins_and_tune_are_taken(tmp_path):
    compared = tmp_path / "compared"
    laws = ("--laws", "smc,pid")
    code, output = here("compare", "paper_arm", *laws, "--set", "duration_s=0.3", "--out", compared)
    assert code == 0, output
    told = " ".join(output.split())
    scenario = compared / "smc" / "scenario.yaml"
    assert f"funnel-hil margin {scenario} --laws smc,pid Nothing records" in told
    assert f"funnel-hil tune {scenario} --laws smc,pid" in told
    for arm, said in (
        ("paper_arm", "gains of smc, pid"),
        ("panda", "follow from the arm's inertia"),
    ):
        out = tmp_path / arm
        code, output = here("compare", arm, *laws, "--set", "duration_s=0.1", "--out", out)
        assert said in " ".join(output.split())
    tries = ("--values", "0,2", "--plants", "1", "--uncertainty", "half")
    code, output = here("margin", scenario, *laws, *tries, "--out", tmp_path / "margin")
    assert code == 0, output


def tables_of(comparison):
    return [verdict_table(comparison), *(law_table(comparison, q) for q in BY_LAW)]


def test_the_most_precise_law_is_named_joint_by_joint(comparison):
    runs = []
    for law, rms in zip(comparison.runs, ([1e-3, 4e-3, 1e-3], [2e-3, 2e-3, 4e-3]), strict=True):
        run = with_bounds(law, kept=True)
        tracking = {**run.summary["tracking"], "rms_rad": rms}
        runs.append(with_summary(run, {**run.summary, "tracking": tracking}))
    sentences = [
        reason for reason in verdict_on_laws(ComparedRuns(runs)).reasons if "RMS" in reason
    ]
    assert sentences == [
        "Smallest RMS error: fixed_time_neural on base_yaw and elbow, at most 0.5 × the next best;"
        " pid on shoulder, at most 0.5 × the next best."
    ]


def test_a_run_without_data_leaves_the_others_in_the_report(comparison, page_of):
    page = page_of(ComparedRuns([empty(comparison.runs[0]), comparison.runs[1]]))
    assert 'id="errors"' in page
    assert 'id="network-output"' not in page
    assert "it broke" in page


def test_a_comparison_of_nothing_but_empty_runs_has_a_report(comparison, page_of):
    page = page_of(ComparedRuns([empty(run) for run in comparison.runs]))
    assert "Nothing was recorded that could be drawn" in page


def test_settling_bounds_are_drawn_for_the_laws_that_have_one(comparison):
    first, second = comparison.runs
    tracking = {**first.summary["tracking"], "settling_bound_s": 2.5}
    bounded = with_summary(first, {**first.summary, "tracking": tracking})
    tracking = {**second.summary["tracking"], "settling_bound_s": None}
    unbounded = with_summary(second, {**second.summary, "tracking": tracking})
    names = [t.name for t in settling(ComparedRuns([bounded, unbounded])).data]
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
    assert settling_from_afar(ComparedRuns(comparison.runs)) is None


def test_texts_from_a_run_are_shown_and_never_executed(comparison, page_of):
    runs = [JudgedRun(run.law + HOSTILE, run.data, faulted(run).result) for run in comparison.runs]
    page = page_of(ComparedRuns(runs))
    assert "<script>alert" not in page


@pytest.mark.parametrize(
    ("values", "largest"), [([1.0, 3.0, 2.0], 3.0), ([1.0, None, 2.0], None), ([None] * 3, None)]
)
def test_the_largest_of_all_joints_is_unknown_if_one_is(comparison, values, largest):
    tracking = comparison.runs[0].result.tracking.model_copy(update={"settling_time_s": values})
    result = comparison.runs[0].result.replaced(tracking=tracking)
    assert SETTLING_TIME.of_worst_joint(result) == largest


def test_a_law_that_sags_without_a_delay_is_set_beside_one_with_gravity(comparison):
    head = verdict_on_laws(comparison)
    sentence = "pid is lost without a delay, under its weight, for which the law has no term"
    for told in (head.reasons, head.printed):
        (found,) = [each for each in told if each.startswith(sentence)]
        assert found.endswith(": compare pid_gravity, which has a gravity term.")
    assert not any("fixed_time_neural is lost" in each for each in head.reasons)
