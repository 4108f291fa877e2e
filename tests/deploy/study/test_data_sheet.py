"""`datasheet`: one command, one page, and the numbers of the studies that it is made of."""

from __future__ import annotations

import json
import re

import pytest

from deploy.reports.kinds import gauged
from deploy.studies.datasheet.data_sheet import DataSheet, worst_window
from deploy.studies.datasheet.page import DrawnSheet, data_sheet_page, headline
from deploy.studies.datasheet.result import DataSheetResult
from deploy.study.quoted import quoted
from deploy.study.settings import COMPENSATION, DRIVE_FEEDBACK
from tests.deploy.own_laws import own_law
from tests.deploy.reports.page_order import assert_shows_before_it_tells
from tests.warm_process import output_of


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A data sheet on a network that ping measured: a constant delay of 2 ms each way."""
    folder = tmp_path_factory.mktemp("sheet")
    replies = (f"64 bytes from arm: icmp_seq={row} ttl=64 time=4.0 ms" for row in range(1, 701))
    end = "700 packets transmitted, 700 received, 0% packet loss, time 6990ms"
    lines = ["PING arm (10.0.0.2) 56(84) bytes of data.", *replies, "", end, ""]
    (folder / "calm.txt").write_text("\n".join(lines))
    words = (
        "datasheet", "paper_arm", "--law", "smc", "--quick", "--workers", "1", "--plants", "1",
        "--set", "duration_s=0.4", "--set", "metrics.from_s=0.2",
        "--network", folder / "calm.txt", "--out", folder / "out",
    )  # fmt: skip
    output = output_of(*words)
    return folder / "out", words, output


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text())


def headline_of(summary):
    return headline(DataSheetResult.model_validate(summary))


def test_its_headline_has_the_numbers_of_its_parts(made):
    out, _, output = made
    summary = summary_of(out)
    margin = summary_of(out / "margin")
    cases = {case["compensation"]: case for case in margin["cases"]}
    assert summary["parts"]["margin"]["cases"] == margin["cases"]
    guaranteed = cases[True]["guaranteed"]
    # Asked with a network, that comes first: 4 ms are no trouble; Wilson's interval of 4 of 4
    # begins at 51 %. The worst stretch of a constant delay is its beginning, as of another window.
    network, quote, windows, quoted, searches, best, *_ = summary["headline"]
    assert network == (
        "calm.txt: kept in 4 of 4 windows of 0.4 s with compensation, without drive loop (--quick)."
    )
    assert windows == (
        "95 % interval of the share of windows that are kept: 51–100 % (more windows: --windows 8)."
    )
    # Then the worst of what is not known of the arm, and only then the best case.
    numbers = {on: case["quoted"] for on, case in cases.items()}
    assert numbers[True] < cases[True]["margin"]
    assert quote == (
        f"paper_arm under smc: quote a round trip of {numbers[True]:g} ms with compensation"
        " (not tested; --quick: one start, one seed, runs of 0.4 s)."
    )
    assert quoted.startswith(f"Round trips: {numbers[True]:g} ms with compensation")
    assert f"; {numbers[False]:g} ms without compensation" in quoted
    assert searches == (
        "Each is the smallest of 3 searches: the arm as given, model masses × 0.8 and model masses"
        " × 1.25."
    )
    # The model of paper_arm errs by design, so that nothing is claimed of an exact one.
    assert best.startswith("Best case, with a model of 0.9 × its masses: ")
    or_more = " or more" if cases[True]["first_failure"] is None else ""
    at_any = f"at any delay up to {guaranteed:g} ms{or_more} with a play-out of "
    assert re.search(at_any + r"[\d.]+ ms, if messages arrive in order and none is lost\.$", best)
    values = [at["value"] for at in summary_of(out / "plants")["cases"][0]["values"]]
    assert values[-1] == guaranteed
    assert all(sentence in " ".join(output.split()) for sentence in summary["headline"])
    assert (out / "worst_window" / "report.html").exists()
    assert "The arm in the worst window" in (out / "report.html").read_text()


def test_the_page_says_how_output_of_ping_is_read(made):
    out, *_ = made
    assumed = "calm.txt: output of ping, 0.01 s between requests (by its statistics), missing"
    assert assumed in summary_of(out)["conditions"]["network"]
    for folder in (out, out / "worst_window"):
        assert assumed in (folder / "report.html").read_text()


def test_windows_run_with_each_equipment_and_the_worst_is_of_compensation_alone(made):
    out, _, output = made
    points = summary_of(out / "network")["points"]
    equipment = [tuple(point["values"][2:]) for point in points]
    assert equipment == 4 * [(True, False), (True, True), (False, False), (False, True)]
    assert [point["values"][1] for point in points[::4]] == [0.0, 1.75, 3.5, 5.25]
    worst = json.loads((out / "worst_window" / "summary.json").read_text())
    lowest = min(point["margin_min"]["lowest"] for point in points[::4])
    assert worst["bounds"]["margin_min"] == pytest.approx(lowest)
    assert re.search(r"with +without +4 of 4 +51–100 %", output)


def test_a_window_begins_just_before_the_worst_burst_in_both_directions(tmp_path):
    # 100 s at 20 ms, with 80 ms from 61.3 to 61.7 s, which windows spread over it may miss.
    delays = [(0.02 * k, 80.0 if 61.3 <= 0.02 * k < 61.7 else 3.0) for k in range(5000)]
    rows = (f"{time_s:.2f},{delay_ms}" for time_s, delay_ms in delays)
    (tmp_path / "bursts.csv").write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    sheet = DataSheet("paper_arm", "smc", str(tmp_path / "bursts.csv"), is_quick=True)
    starts_s = [run.columns["link.downlink.trace.start_s"] for run in sheet.windows().first()]
    # The first half second that holds the whole burst begins at 61.2 s; 0.25 s before it:
    assert max(set(starts_s) - {0.0, 25.0, 50.0, 75.0}) == pytest.approx(60.97, abs=0.03)
    for run in sheet.windows().first():
        assert (
            run.columns["link.uplink.trace.start_s"] == run.columns["link.downlink.trace.start_s"]
        )


def test_more_windows_are_tried_where_asked_for(made):
    network = str(made[1][made[1].index("--network") + 1])
    sheets = {
        count: DataSheet("paper_arm", "smc", network, is_quick=True, network_windows=count)
        for count in (None, 2, 9)
    }
    counts = {count: len(sheet.windows_of(network)[1]) for count, sheet in sheets.items()}
    assert counts == {None: 4, 2: 1, 9: 8}  # the worst stretch is at the start, as another window


def test_feedback_at_the_drives_that_is_set_is_not_varied(made):
    _, words, _ = made
    network = words[words.index("--network") + 1]
    sheet = DataSheet("paper_arm", "smc", str(network), fixed={DRIVE_FEEDBACK: True}, is_quick=True)
    runs = list(sheet.windows().first())
    assert [run.columns[COMPENSATION] for run in runs] == 4 * [True, False]
    assert all(f"{DRIVE_FEEDBACK}=true" in run.overrides for run in runs)


def test_the_headline_names_estimated_rotors_that_decide(made):
    out, _, _ = made
    summary = summary_of(out)
    assert "rotors" not in " ".join(headline_of(summary))  # paper_arm has none
    for case in summary["parts"]["margin"]["cases"]:
        kept_ms = None if case["compensation"] else 0.5
        case["smaller_rotors"] = {**case, "margin": kept_ms, "first_failure": 1.0}
        case |= quoted(case)
    (sentence,) = (each for each in headline_of(summary) if each.startswith("Round trips: "))
    assert "0.5 ms without compensation (with a tenth of the estimated rotors; " in sentence
    assert "none with compensation (with a tenth of the estimated rotors; " in sentence


def test_the_headline_says_what_would_keep_a_lost_network(made):
    out, _, _ = made
    summary = summary_of(out)
    for point in summary["parts"]["network"]["points"]:
        point["runs_kept"] = int(point["values"][3])  # with drive loop alone
    verdict, _, *rest = headline_of(summary)
    assert [verdict, *rest[:2]] == [
        "calm.txt: lost in 4 of 4 windows of 0.4 s with compensation, without drive loop"
        " (--quick).",
        "95 % interval of the share of windows that are kept: 0–49 % (more windows: --windows 8).",
        "Kept in 4 of 4 with compensation, with drive loop: add"
        " --set controller.drive_feedback.enabled=true.",
    ]


def test_without_a_network_the_headline_is_the_number_to_quote_alone(made):
    out, _, _ = made
    summary = summary_of(out)
    del summary["parts"]["network"]
    cases = summary["parts"]["margin"]["cases"]
    best = max(cases, key=lambda case: case["quoted"])
    setting = "with" if best["compensation"] else "without"
    assert headline_of(summary)[0] == (
        f"paper_arm under smc: quote a round trip of {best['quoted']:g} ms {setting} compensation"
        " (not tested; --quick: one start, one seed, runs of 0.4 s)."
    )


def test_the_effort_of_its_runs_is_a_condition_and_no_caveat_where_starts_are_several(made):
    out, _, output = made
    summary = summary_of(out)
    effort = "--quick: one start, one seed, runs of 0.4 s"
    assert summary["conditions"]["effort"] == effort
    assert f"effort: {effort}" in " ".join(output.split())
    assert "Not tested: runs of 0.4 s are too short" in " ".join(summary["headline"])
    summary["quick"], summary["parts"]["margin"]["offsets"] = False, [0.5, 1.0]
    assert "one start" not in " ".join(headline_of(summary))


def test_each_change_that_helped_has_its_command(made):
    out, _, output = made
    tried = [
        each
        for case in summary_of(out / "margin")["cases"]
        for each in (case["what_helps"] or {"tried": ()})["tried"]
    ]
    assert any(each["held"] for each in tried)
    assert all(("command" in each) == each["held"] for each in tried)
    page = (out / "report.html").read_text()
    assert_shows_before_it_tells(page)
    for each in tried:
        command = f"simulate margin/scenarios/{each['point']}.yaml --set seed={each['seed']}"
        assert command in page.replace("<wbr>", "")
        assert (out / "margin" / "scenarios" / f"{each['point']}.yaml").exists()
    assert "funnel-hil simulate" not in output  # a terminal shows what helps, the report how


def test_the_command_does_nothing_again_and_its_gate_fails(made):
    out, words, _ = made
    before = summary_of(out)
    output = output_of(*words, "--at-least", "127.5ms", code=3)
    assert "gate: " in output
    assert summary_of(out)["parts"] == before["parts"]
    assert "runs were there from before" in output


def test_its_conditions_name_all_that_was_set(made):
    out, _, output = made
    assert summary_of(out)["conditions"]["set"] == "duration_s=0.4, metrics.from_s=0.2"
    assert "set: duration_s=0.4, metrics.from_s=0.2" in " ".join(output.split())


def test_there_is_one_number_to_quote_in_all_places(made):
    out, words, output = made
    summary = summary_of(out)
    case = summary["parts"]["margin"]["cases"][1]
    number = f"{case['quoted']:g} ms"
    assert case["quoted"] < case["margin"]  # else this shows nothing
    quote = summary["quote"]
    assert (quote["round_trip_ms"], quote["setting"]) == (case["quoted"], "with compensation")
    assert quote["because"] == "model error"
    assert quote["effort"] == "--quick: one start, one seed, runs of 0.4 s"
    sheet = DrawnSheet(DataSheetResult.model_validate(summary), None)
    page = data_sheet_page(sheet)
    for place in (page.verdict.reasons[0], page.facts[0].value, " ".join(output.split())):
        assert quote["text"] in place
    figure = page.panels()[0].draw(sheet)
    names = [line.name for line in figure.data]
    assert f"quote with compensation: {number}" in names
    assert f"best case, with compensation: {case['guaranteed']:g} ms" in names
    table = next(each for each in page.tables if "round trip" in each.title)
    column = [each.heading for each in table.columns].index("Margin to quote")
    assert table.cells[1][column].text == number
    gate = output_of(*words, "--at-least", "127.5ms", code=3)
    assert f"with compensation, margin to quote: {number}" in gate
    assert "every pattern of delays" not in gate


def test_a_gate_takes_it_with_compensation_and_plants(made):
    out, _, _ = made
    summary = summary_of(out)
    numbers = {each.name: each.value for each in gauged(summary)}
    assert [name.endswith("uncertain plants") for name in numbers] == [False, True]
    assert next(iter(numbers.values())) == summary["parts"]["margin"]["cases"][1]["quoted"]


def test_its_report_is_made_again_from_its_parts(made):
    out, _, _ = made
    before, manifest = summary_of(out), (out / "manifest.json").read_text()
    (out / "report.html").unlink()
    output_of("report", out)
    assert (out / "manifest.json").read_text() == manifest  # of what was run, not of this report
    assert summary_of(out)["parts"] == before["parts"]
    assert "The arm in the worst window" in (out / "report.html").read_text()


def test_a_folder_with_other_results_is_refused(made, tmp_path):
    out, words, _ = made
    output = output_of(*words, "--set", "plant.substeps=2", code=2)
    assert "has another data sheet" in output
    (tmp_path / "summary.json").write_text("{}")
    output = output_of(*words[:-1], tmp_path, code=2)
    assert "holds results (summary.json)" in output
    assert summary_of(out)["kind"] == "datasheet"


def test_a_law_that_fails_in_every_run_is_an_error(tmp_path, monkeypatch):
    law = own_law(tmp_path, "raise ValueError('no such luck')")
    monkeypatch.chdir(tmp_path)
    words = ("--quick", "--set", "duration_s=0.1", "--set", "metrics.from_s=0", "--workers", "1")
    output = output_of("datasheet", "paper_arm", "--law", law, *words, "--out", "out", code=1)
    assert "every run failed: " in output
    assert "no such luck" in output


def test_the_worst_window_of_those_that_are_kept_is_the_worst_without_compensation():
    start = "link.uplink.trace.start_s"

    def row(at_s, outside, *, compensated):
        return {
            "controller.delay_compensation.enabled": compensated, start: at_s, "error": None,
            "violation_fraction": outside, "margin_min": 0.5 if not outside else -outside,
            "first_violation_s": 0.1 if outside else None, "verdict": "lost" if outside else "kept",
        }  # fmt: skip

    bare = [
        row(at_s, outside, compensated=False) for at_s, outside in ((0, 0.1), (15, 0.9), (30, 0.2))
    ]
    kept = [row(at_s, 0.0, compensated=True) for at_s in (0, 15, 30)]
    assert worst_window([*bare, *kept])[start] == 15
    kept[2] = row(30, 0.01, compensated=True)
    assert worst_window([*bare, *kept])[start] == 30
