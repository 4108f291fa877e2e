"""Margins for every pattern of delays: guaranteed with play-out, the worst one found without."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from deploy.judge.metrics import summarise
from deploy.reports.studies.results import judge_rows
from deploy.reports.tables import as_markdown
from deploy.run.simulate import simulate
from deploy.scenario.playout import EXPECTED
from deploy.scenario.scenario import load_setup
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.sentences import margin_sentences
from deploy.studies.margin.tables import margin_table, margins_by_law
from deploy.study.follow_ups.patterns import catalogue, neighbours
from plant_emulator.channel.pattern import share_in_pattern
from tests.deploy.study.studies import Here, case_of, conduct, folder_of, made_up, margin_of

ON = "controller.delay_compensation.enabled"
LAW = "fixed_time_adaptive"


def patterns_of(**values):
    """A study of one start and three values: the scenario of each point takes time to write."""
    given = {"laws": ["pid"], "seeds": 1, "offsets": [1.0], "resolution": 4, "limit": 12}
    return margin_of(**{**given, "pattern": "any", "disturbances": None, **values})


def pattern_in(run):
    return json.loads(run.columns.get("pattern") or "{}")


def judged(run, limit, **values):
    """A row of a run that keeps its bounds up to this value, by less the nearer it is."""
    over = run.columns["value"] - limit
    more = {"violation_fraction": max(0.0, over / 100), "motion": "same"}
    return made_up(run, **{**more, **values}) | {"margin_min": -over / 100}


def squares_lose(run):
    """Constant delays hold to 9 ms, square waves to 5, the other patterns to 7."""
    shape = pattern_in(run).get("shape")
    return judged(run, {None: 9.0, "square": 5.0}.get(shape, 7.0))


def test_without_playout_the_worst_pattern_is_found(tmp_path):
    margin = patterns_of()
    whole, folder = conduct(margin, tmp_path / "out", Here(squares_lose, seed=3))
    assert whole
    summary = margin.summary(folder.rows)
    (case,) = summary["cases"]
    assert summary["completed"]
    assert margin.expected == len(folder.rows)
    assert (case["margin"], case["first_failure"]) == (8.0, 12.0)  # of a constant delay
    assert case["guaranteed"] is None
    worst = case["worst_pattern"]
    assert worst["pattern"]["shape"] == "square"
    assert (worst["margin"], worst["value"]) == (4.0, 8.0)
    # The whole catalogue at 8 and 4 ms, and ten neighbours of the worst one at 4.
    assert case["patterns"]["tried"] == len(catalogue(1.0)) + 10 == 36
    assert f"every pattern of delays: 4 ms, {case['patterns']['tried']} tried" in " ".join(
        margin_sentences(MarginResult.model_validate(summary))
    )
    assert "4 ms, " in str(margin_table(MarginResult.model_validate(summary)).rows)
    assert "4 ms; every pattern: 4 ms, " in as_markdown(
        margins_by_law(MarginResult.model_validate(summary))
    )


def test_a_quick_search_tries_six_patterns_at_each_value_and_no_neighbours(tmp_path):
    """Four of a handful and two kinds of bursts, at 8 and at 4 ms."""
    margin = patterns_of(thorough=False)
    _, folder = conduct(margin, tmp_path / "out", Here(squares_lose, seed=3))
    case = case_of(margin, folder)
    assert (case["worst_pattern"]["margin"], case["patterns"]["tried"]) == (4.0, 6)
    assert margin.own_test["thorough"] is False
    assert "thorough" not in patterns_of().own_test  # as in older baselines


def test_a_neighbour_that_loses_lowers_the_margin(tmp_path):
    """At 8 ms only patterns that begin later lose, and of the catalogue none does."""

    def later_ones_lose(run):
        phase_ms = pattern_in(run).get("phase_ms", 0.0)
        return judged(run, 7.0 if phase_ms else 8.5 if pattern_in(run) else 9.0)

    margin = patterns_of()
    assert conduct(margin, tmp_path / "out", Here(later_ones_lose))[0]
    worst = case_of(margin, folder_of(margin, tmp_path / "out"))["worst_pattern"]
    assert (worst["margin"], worst["value"]) == (4.0, 8.0)
    assert worst["pattern"]["phase_ms"] > 0


SET = f"The scenario's own link gives d = 0 ms at the start: add --set {EXPECTED}=8."


@pytest.mark.parametrize(
    ("compensation", "given", "d_ms", "remedy"),
    [
        (True, {}, 8.0, SET),
        (True, {EXPECTED: 20}, 20.0, None),
        (True, {"link.playout_ms": 8}, 8.0, None),
        (False, {"link.playout_ms": 11.5}, 11.5, None),
        (True, {"rate_hz": 300, "plant.substeps": 4}, 8.333332, SET.replace("=8", "=8.333332")),
    ],
    ids=["automatic", "automatic and set", "fixed", "without compensation", "rounded up"],
)
def test_a_guarantee_names_its_playout_and_how_to_set_it(
    tmp_path, compensation, given, d_ms, remedy
):
    """At 300 Hz with 4 steps of 0.83 ms, torques act 8.33 ms after their state."""
    margin = patterns_of(compensation=[compensation], set=given)
    work = Here(lambda run: judged(run, 9.0))
    _, folder = conduct(margin, tmp_path / "out", work)
    summary = margin.summary(folder.rows)
    (case,) = summary["cases"]
    assert (case["guaranteed"], case["guaranteed_d_ms"]) == (8.0, d_ms)
    assert (case["guaranteed_command"] is None) == (remedy is None)
    text = " ".join(margin_sentences(MarginResult.model_validate(summary)))
    condition = f"arrives in order and is not lost, with a play-out of d = {d_ms:.9g} ms; the"
    assert condition in text
    assert remedy in text if remedy else "add --set" not in text
    # All runs under the guarantee use its d, whatever their own delays would choose.
    for run in work.submitted:
        if run.columns["pattern"] is not None and "link.playout_ms" not in given:
            assert load_setup(run.scenario, run.overrides).playout_range_ns == 2 * (
                round(1e6 * d_ms),
            )


@pytest.mark.parametrize(
    "given",
    [
        {"link.playout_ms": 5},
        {EXPECTED: 5},
        {"link.uplink.jitter_ms": 1},
        {"link.uplink.rate_kbit_s": 1000},
    ],
    ids=["too short", "too short by expectation", "jitter", "bandwidth"],
)
def test_without_a_playout_above_all_delays_nothing_is_guaranteed(tmp_path, given):
    margin = patterns_of(compensation=[True], set=given)
    case = case_of(margin, conduct(margin, tmp_path, Here(lambda run: judged(run, 9.0)))[1])
    for key in ("guaranteed", "guaranteed_d_ms", "guaranteed_command", "scenario_d_ms"):
        assert case[key] is None
    assert case["worst_pattern"] is not None
    assert case["patterns"]["motions"] is None


@pytest.mark.parametrize(
    ("direction", "own", "value", "rate_hz", "splits_ms"),
    [
        ("both", {}, 8.0, 1000, {(8.0, 0.0), (0.0, 8.0)}),
        ("both", {}, 8.0, 250, {(8.0, 0.0), (0.0, 8.0)}),
        ("both", {}, 8.0, 300, {(8.0, 0.0), (6.666666, 1.333334), (0.0, 8.0)}),
        ("uplink", {"link.downlink.delay_ms": 1.5}, 8.0, 1000,
         {(9.5, 0.0), (9.0, 0.5), (0.0, 9.5)}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("running", [False, True])
def test_a_guarantee_is_tested_with_all_of_the_delay_in_one_direction_and_bursts_at_the_start(
    tmp_path, direction, own, value, rate_hz, splits_ms, running
):
    values = {"compensation": [True], "direction": direction, "running": [running]}
    given = {**own, "rate_hz": rate_hz, "duration_s": 5.0}
    margin, work = patterns_of(**values, set=given), Here(lambda run: judged(run, 9.0))
    case = case_of(margin, conduct(margin, tmp_path, work)[1])
    assert case["guaranteed"] == value
    patterns, tick_ns = [], round(1e9 / rate_hz)
    found, bursts = set(), set()
    for run in work.submitted:
        link = load_setup(run.scenario, run.overrides).scenario.link
        if pattern_in(run).get("shape") == "square" and link.uplink.pattern.duty != 0.5:
            high = [share_in_pattern(link.uplink.pattern, tick * tick_ns) for tick in range(50)]
            bursts.add(tuple(np.flatnonzero(high)))
        elif run.columns["pattern"] is not None and "shape" not in pattern_in(run):
            ways = (link.uplink, link.downlink)
            found.add(tuple(
                max([each.delay_ms, *(change.delay_ms for change in each.schedule)])
                for each in ways
            ))  # fmt: skip
        patterns.append(run.columns["pattern"])
    assert found == splits_ms
    # 4 ms, or the whole ticks next to it: at once, and after five times as long.
    count = max(1, round(4e6 / tick_ns))
    assert bursts == {tuple(range(at, at + count)) for at in (0, 5 * count)}
    assert case["patterns"]["tried"] == len(set(filter(None, patterns)))


def test_patterns_with_another_motion_give_no_guarantee(tmp_path):
    """A message that is lost, late or overtaken acts at another time."""

    def moved(run):
        shape = pattern_in(run).get("shape")
        return judged(run, 9.0, motion="other" if shape == "random" else "same")

    margin = patterns_of(compensation=[True])
    _, folder = conduct(margin, tmp_path / "out", Here(moved))
    case = case_of(margin, folder)
    assert case["guaranteed"] is None
    assert case["guaranteed_d_ms"] is None
    assert case["patterns"] == {"tried": 8, "motions": 2}


def test_a_split_that_loses_is_the_worst_pattern_and_its_command_has_its_delays(tmp_path):
    def uplink_loses(run):
        return judged(run, 7.0 if pattern_in(run).get("uplink_ms") == 8.0 else 9.0)

    margin = patterns_of(compensation=[True])
    _, folder = conduct(margin, tmp_path / "out", Here(uplink_loses))
    worst = judge_rows(margin, folder)["cases"][0]["worst_pattern"]
    assert worst["pattern"] == {"uplink_ms": 8.0, "downlink_ms": 0.0}
    _, _, scenario, *words = shlex.split(worst["command"])
    link = load_setup(scenario, words[1::2]).scenario.link
    assert (link.uplink.delay_ms, link.downlink.delay_ms) == (8.0, 0.0)


def test_a_run_by_the_command_of_a_guarantee_moves_alike_under_any_pattern(tmp_path):
    """Bursts of its own, which are too rare for the quantile that the scenario itself takes."""
    margin = patterns_of(laws=[LAW], compensation=[True], resolution=16, limit=16, duration_s=0.5)
    _, folder = conduct(margin, tmp_path / "out", Here())
    (case,) = judge_rows(margin, folder)["cases"]
    assert (case["guaranteed"], case["guaranteed_d_ms"]) == (16.0, 16.0)
    (moved,) = {row["motion"] for row in folder.rows if row["value"] == 16.0}
    file = tmp_path / "burst.csv"
    rows = [f"{1e-3 * at:.3f},{16 if at in (3, 4, 333) else 0}" for at in range(1000)]
    file.write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    _, _, scenario, *words = shlex.split(case["guaranteed_command"])
    burst = f"link.uplink.trace={{file: {file}, start_s: 0}}"
    assert simulate(load_setup(scenario, [*words[1::2], burst])).data().motion == moved
    without = [word for word in words[1::2] if EXPECTED not in word]
    assert simulate(load_setup(scenario, [*without, burst])).data().motion != moved


def test_neighbours_are_those_of_their_seed():
    pattern = {"shape": "square", "period_ms": 60.0}
    one, same, other = (neighbours(pattern, seed, 1.0) for seed in ("a", "a", "b"))
    assert one == same != other
    assert all(30 <= each["period_ms"] <= 120 for each in one)
    assert len({json.dumps(each) for each in one}) == 10


def test_an_arm_with_playout_moves_alike_under_every_pattern_and_without_loses_some(tmp_path):
    """As measured by hand: 16 ms in square waves of 20 and 60 ms lose where 16 ms constant keep."""
    common = {
        "laws": [LAW], "compensation": [True], "offsets": [1.0], "seeds": 1,
        "resolution": 16, "limit": 16, "duration_s": 1.0,
    }  # fmt: skip
    found = {}
    for playout in ("auto", 0):
        margin = patterns_of(**common, set={"link.playout_ms": playout})
        _, folder = conduct(margin, tmp_path / str(playout), Here())
        found[playout] = judge_rows(margin, folder)["cases"][0]
    assert found["auto"]["margin"] == found[0]["margin"] == 16.0
    assert found["auto"]["guaranteed"] == 16.0
    assert found["auto"]["patterns"] == {"tried": 8, "motions": 1}
    worst = found[0]["worst_pattern"]
    assert (worst["margin"], worst["value"]) == (0.0, 16.0)
    assert worst["pattern"]["shape"] == "square"

    program, command, scenario, *words = shlex.split(worst["command"])
    assert (program, command) == ("funnel-hil", "simulate")
    assert 'link.uplink.pattern={"shape": "square"' in worst["command"]
    again = summarise(simulate(load_setup(scenario, words[1::2])).data())
    assert again["verdict"] == "lost"
    assert again["bounds"]["margin_min"] == worst["margin_min"]

    assert [Path(file).parent for file in worst["traces"]] == 2 * [tmp_path / "0"]
    _, _, scenario, *words = shlex.split(worst["trace_command"])
    replayed = load_setup(scenario, words[1::2])
    assert replayed.link.uplink.pattern is None
    assert replayed.link.uplink.trace.file == worst["traces"][0]
    of_trace = summarise(simulate(replayed).data())
    assert of_trace["verdict"] == "lost"
    assert of_trace["bounds"]["margin_min"] == pytest.approx(worst["margin_min"], rel=1e-3)


DRIVES = ("controller.drive_feedback.enabled=true", "plant.drive_feedback.enabled=true")
SHAPES = st.fixed_dictionaries(
    {
        "shape": st.sampled_from(["square", "sawtooth", "falling", "random", "walk"]),
        "period_ms": st.floats(0.5, 300),
        "phase_ms": st.floats(0, 300),
        "least_ms": st.floats(0, 8),
    }
)


@settings(
    max_examples=6, deadline=None, suppress_health_check=list(HealthCheck), phases=[Phase.generate]
)
@given(
    st.tuples(SHAPES, SHAPES),
    st.sampled_from(["paper_arm", "panda_motors", "ur5e_motors"]),
    st.sampled_from([LAW, "fixed_time_neural", "smc"]),
    st.sampled_from([(), DRIVES]),
)
def test_any_patterns_in_both_directions_give_the_motion_of_the_constant_delay(
    patterns, arm, law, drives
):
    common = [f"controller.law={law}", f"{ON}=true", "duration_s=0.3", *drives]
    common += [f"link.{name}.delay_ms=8" for name in ("uplink", "downlink")]
    shapes = zip(("uplink", "downlink"), map(json.dumps, patterns), strict=True)
    varying = [f"link.{name}.pattern={shape}" for name, shape in shapes]
    runs = [simulate(load_setup(arm, [*common, *more])) for more in ((), varying)]
    constant, varied = (summarise(run.data()) for run in runs)
    assert varied["motion"] == constant["motion"]
    assert varied["timing"]["deadline_misses"] == constant["timing"]["deadline_misses"]


@pytest.mark.parametrize(
    ("arm", "period_ms", "largest_ms"),
    [("paper_arm", 60, 16), ("paper_arm", 20, 48), ("panda_motors", 60, 48)],
)
def test_a_square_wave_loses_without_playout_what_a_constant_delay_keeps(
    arm, period_ms, largest_ms
):
    """As measured by hand; the downlink takes 1 ms, the uplink between 1 and the rest."""

    def run(pattern, playout):
        given = {
            "duration_s": 1.0, "controller.law": LAW, ON: "true", "link.playout_ms": playout,
            "link.downlink.delay_ms": 1, "link.uplink.delay_ms": largest_ms - 1,
            "link.uplink.pattern": pattern,
        }  # fmt: skip
        setup = load_setup(arm, [f"{key}={value}" for key, value in given.items()])
        return summarise(simulate(setup).data())

    wave = f"{{shape: square, period_ms: {period_ms}, least_ms: 1}}"
    constant, levelled, plain = run("null", "auto"), run(wave, "auto"), run(wave, 0)
    assert constant["verdict"] == levelled["verdict"] == "kept"
    assert levelled["motion"] == constant["motion"]
    assert levelled["transport"]["playout"]["late"] == 0
    assert plain["verdict"] == "lost"
    assert plain["motion"] != constant["motion"]
