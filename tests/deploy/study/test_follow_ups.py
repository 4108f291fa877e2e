"""What a study of margins tries once it has a margin: remedies, and lost or late messages."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from pathlib import Path

import pytest

from deploy.judge.metrics import summarise
from deploy.reports.kinds import gauged
from deploy.reports.studies.results import judge_rows
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.margin.command import MarginOptions, definition_with
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.sentences import brief_margin_sentences, margin_sentences
from deploy.studies.margin.tables import disturbance_tables, help_tables, margin_table
from deploy.study.execution.folder import create_folder, find_folder
from deploy.study.follow_ups.disturbances import DisturbanceSizes, changes
from tests.deploy.study.studies import Here, case_of, conduct, made_up, margin_of
from tests.warm_process import output_of

PLAIN = {"set": {}, "laws": ["pid"], "seeds": 1, "offsets": [1.0, 0.5], "resolution": 4}
LOST = {"violation_fraction": 0.1, "margin_min": -0.2}
HELPS = {"compensation": 0.31, "drive loop": 0.42, None: 0.5}


def helped(**values):
    return margin_of(**{**PLAIN, "limit": 12, "resolution": 1, "what_helps": True, **values})


def below_six(run):
    """At 6 ms all is lost, but with compensation or a drive loop."""
    change, value = run.columns["change"], run.columns["value"]
    if value < 6.0 or (change in HELPS and change is not None):
        return made_up(run) | {"margin_min": HELPS.get(change, 0.1)}
    return made_up(run, **LOST)


def test_remedies_that_help_the_lost_start_are_tried_from_every_start(tmp_path):
    study = helped(resolution=0.5)
    whole, folder = conduct(study, tmp_path / "out", Here(below_six, seed=4))
    assert whole
    case, helps = case_of(study, folder), case_of(study, folder)["what_helps"]
    assert (case["margin"], case["first_failure"], helps["value"]) == (5.5, 6.0, 6.0)
    assert {each["change"]: each["held"] for each in helps["tried"]} == {
        "compensation": True,
        "drive loop": True,
        "half the gains": False,
        "twice the rate": False,
    }
    runs = Counter(row["change"] for row in folder.rows)
    assert {each["change"]: each["starts"] for each in helps["tried"]} == {
        "compensation": 2, "drive loop": 2, "half the gains": 1, "twice the rate": 1,
    }  # fmt: skip
    assert runs.total() - runs[None] <= runs.total() / 3
    assert study.expected == len(folder.rows)
    best = helps["best"]
    assert (best["change"], best["margin_min"]) == ("drive loop", 0.42)
    assert "controller.drive_feedback.enabled=true" in shlex.split(best["command"])
    (table,) = help_tables(MarginResult.model_validate(study.summary(folder.rows)))
    assert table.title == "What helps at 6 ms, paper_arm, pid"
    shown = [(name.text, kept.text, left.text) for name, kept, _, left, *_ in table.cells]
    assert shown[:2] == [("compensation", "yes", "31"), ("drive loop", "yes", "42")]
    assert [row[:2] for row in shown[2:]] == [("twice the rate", "no"), ("half the gains", "no")]


def test_no_margin_is_quoted_before_its_follow_ups_are_over(tmp_path):
    """With a model of 0.8 × the masses all is lost from 4 ms on; the command ends within that."""

    def lost(run):
        has_error = str(run.columns["change"]).startswith("model masses")
        return made_up(run, **(LOST if run.columns["value"] > (3 if has_error else 9) else {}))

    numbers, count, whole = set(), 0, False
    while not whole:
        count += 1
        study = helped(
            quantity="jitter", resolution=3, what_helps=False, model_errors=[0.8]
        )  # no theory, and few runs: the study is made once for each of them
        whole, folder = conduct(study, tmp_path / f"{count}", Here(lost, at_most=count))
        case = case_of(study, folder)
        numbers.add((case["quoted"], case["quoted_because"]))
    assert numbers == {(None, None), (3.0, "model error")}


@pytest.mark.parametrize("seeds", [1, 3, 10])
def test_remedies_are_at_most_a_third_of_all_runs(tmp_path, seeds):
    study = helped(quantity="jitter", seeds=seeds)  # which draws random numbers
    whole, folder = conduct(study, tmp_path / "out", Here(below_six, seed=4))
    runs = Counter(row["change"] for row in folder.rows)
    assert whole
    assert study.summary(folder.rows)["completed"]
    assert runs.total() - runs[None] <= runs.total() / 3


def test_where_nothing_helps_the_result_says_so(tmp_path):
    study = helped(compensation=[True], drive_feedback=[True])
    lost = Here(lambda run: made_up(run, **(LOST if run.columns["value"] > 5 else {})))
    _, folder = conduct(study, tmp_path / "out", lost)
    helps = case_of(study, folder)["what_helps"]
    assert helps["best"] is None
    # What is in force already is not tried again.
    assert [each["change"] for each in helps["tried"]] == ["twice the rate", "half the gains"]
    (table,) = help_tables(MarginResult.model_validate(study.summary(folder.rows)))
    assert [kept.text for _, kept, *_ in table.cells] == ["no", "no"]


@pytest.mark.parametrize(
    ("values", "tried"),
    [
        ({"set": {"link.playout_ms": 0}, "compensation": [True]},
         {"drive loop", "twice the rate", "half the gains", "automatic play-out"}),
        ({"quantity": "rate_hz", "limit": 400, "resolution": 25},
         {"compensation", "drive loop", "half the gains"}),
        ({"scenarios": ["paper_arm_can"]},
         {"compensation", "drive loop", "twice the rate", "half the gains"}),
    ],
    ids=["play-out", "rate", "can"],
)  # fmt: skip
def test_remedies_are_those_that_the_scenario_accepts_and_that_change_it(tmp_path, values, tried):
    study = helped(**values)

    def lost(run):
        is_lost = 9 < run.columns["value"] < 600  # ms, or Hz
        return made_up(run, **(LOST if is_lost else {}))

    _, folder = conduct(study, tmp_path / "out", Here(lost))
    assert {each["change"] for each in case_of(study, folder)["what_helps"]["tried"]} == tried


def test_what_never_fails_needs_no_help(tmp_path):
    study = helped()
    _, folder = conduct(study, tmp_path / "out", Here(made_up))
    assert case_of(study, folder)["what_helps"] is None
    assert study.summary(folder.rows)["completed"]


def test_a_gate_after_a_margin_does_no_run_again(tmp_path):
    path = create_folder(helped(), tmp_path / "out")
    conduct(helped(), path, Here(below_six))
    plain = helped(what_helps=False)
    assert find_folder(plain, path) == path
    workers = Here(below_six)
    done, folder = conduct(plain, path, workers)
    folder.write(completed=True)  # as at the end of the command
    assert done
    assert not workers.submitted
    assert conduct(helped(), path, workers)[0]
    assert not workers.submitted  # what helps is still there


def test_compensation_helps_an_arm_and_the_command_shows_it(tmp_path):
    study = helped(laws=["fixed_time_adaptive"], offsets=[1.0], duration_s=0.6)
    _, folder = conduct(study, tmp_path / "out", Here())
    helps = case_of(study, folder)["what_helps"]
    held = {each["change"]: each for each in helps["tried"] if each["held"]}
    assert "compensation" in held
    best = helps["best"]
    _, command, scenario, *words = shlex.split(best["command"])
    again = summarise(simulate(load_setup(scenario, words[1::2])).data())
    assert (command, again["verdict"]) == ("simulate", "kept")
    assert again["bounds"]["margin_min"] == best["margin_min"]


def disturbed(**values):
    values = {"offsets": [1.0], "limit": 16, "pattern": "any", "compensation": [True], **values}
    return helped(what_helps=False, **values)


def test_disturbances_are_tried_at_the_margin_its_half_and_its_quarter(tmp_path):
    def late_loses(run):
        """Messages that are late lose above 5 ms, without a bridge."""
        change = run.columns["change"] or ""
        is_lost = "late" in change and "bridge" not in change and run.columns["value"] > 5
        return made_up(run, motion="same", **(LOST if is_lost else {}))

    study = disturbed()
    _, folder = conduct(study, tmp_path / "out", Here(late_loses, seed=2))
    case, summary = case_of(study, folder), study.summary(folder.rows)
    assert summary["completed"]
    assert (case["margin"], case["guaranteed"]) == (16.0, 16.0)
    found = {(e["disturbance"], e["bridge"]): e for e in case["disturbances"]}
    assert len(found) == 8
    late = found["1 % late by 20 ms", False]
    assert late["held_up_to"] == 4.0
    assert [(at["value"], at["held"]) for at in late["tried"]] == [
        (16.0, False),
        (8.0, False),
        (4.0, True),
    ]
    assert {each["held_up_to"] for key, each in found.items() if each is not late} == {16.0}
    (table,) = disturbance_tables(MarginResult.model_validate(summary))
    assert [row[3:] for row in table.rows if "1 % late by 20 ms" in row] == [
        ["without", "4 ms", "8 ms"],
        ["with", "16 ms", "–"],
    ]


def test_without_compensation_there_is_no_bridge_and_null_leaves_disturbances_out(tmp_path):
    def kept(run):
        return made_up(run, motion="same")

    study = disturbed(compensation=[False], set={"link.playout_ms": 16})
    _, folder = conduct(study, tmp_path / "a", Here(kept))
    assert {each["bridge"] for each in case_of(study, folder)["disturbances"]} == {False}
    study = disturbed(disturbances=None)
    _, folder = conduct(study, tmp_path / "b", Here(kept))
    assert case_of(study, folder)["disturbances"] is None
    assert disturbance_tables(MarginResult.model_validate(study.summary(folder.rows))) == []


def transport_with(name, sizes):
    study = disturbed(disturbances=sizes, set={"duration_s": 2.0})
    setting = study.cases[0].setting
    overrides = changes(DisturbanceSizes(**sizes), setting)[name]
    setup = load_setup(setting.scenario, setting.at(16.0, overrides))
    run = summarise(simulate(setup).data())
    assert run["seed_used"] is False
    return run["transport"]


def test_losses_late_messages_and_overtaking_have_their_stated_size():
    lost = transport_with("up to 3 lost in a row", {"lost_in_a_row": 3})
    late = transport_with("2 % late by 7 ms", {"late_share": 0.02, "late_by_ms": 7.0})
    overtaken = transport_with("overtaking, random delays", {})
    outage = transport_with("outage of 50 ms", {"outage_ms": 50.0})
    for direction in ("uplink", "downlink"):
        assert lost[direction]["loss_burst"] == {"mean": 2.0, "longest": 3}
        assert late[direction]["delay_ms"]["max"] == 15.0
        assert late[direction]["reordered"] == 0
        assert overtaken[direction]["reordered"] > 100
        assert overtaken[direction]["lost"] == 0
    assert overtaken["playout"]["late"] == 0
    assert outage["uplink"]["loss_burst"]["longest"] == 50
    # No state arrives, so the commands lost are those that answer the states on their way.
    assert outage["downlink"]["loss_burst"]["longest"] == 8


@pytest.mark.parametrize(
    ("sizes", "message"),
    [({"late_share": 2}, "disturbances.late_share"), ({"lost": 2}, "disturbances.lost")],
)
def test_impossible_sizes_of_disturbances_are_refused(sizes, message):
    with pytest.raises(ScenarioError, match=message):
        disturbed(disturbances=sizes)


@pytest.mark.parametrize(
    ("set_", "limit", "worst"),
    [({"link.playout_ms": 0}, 6.0, 6.0), ({"link.playout_ms": 0}, 0.5, 0.0), ({}, 99.0, 12.0)],
    ids=["worst pattern", "no pattern holds", "guaranteed"],
)
def test_a_gate_takes_the_figure_for_every_pattern(tmp_path, set_, limit, worst):
    def patterns_lose(run):
        is_lost = run.columns["value"] > limit and run.columns["pattern"] is not None
        return made_up(run, motion="same", **(LOST if is_lost else {}))

    study = disturbed(disturbances=None, limit=12, set=set_)
    _, folder = conduct(study, tmp_path / "out", Here(patterns_lose))
    summary = judge_rows(study, folder)
    assert summary["cases"][0]["margin"] == 12.0
    (number,) = gauged(json.loads(json.dumps(summary)))
    name = "paper_arm, pid with compensation, margin to quote"
    assert (number.name, number.value) == (name, worst)
    assert number.is_below(12.0) == (worst < 12.0)


def test_gate_of_every_pattern_ends_the_command_and_compares_with_its_like(funnel_hil, tmp_path):
    """As measured by hand: square waves of up to 16 ms lose where constant 16 ms are kept."""
    (file := tmp_path / "waves.yaml").write_text(
        "{laws: [fixed_time_adaptive], compensation: [true], offsets: [1.0], resolution: 16,"
        " limit: 16, disturbances: null, set: {duration_s: 1.0, link.playout_ms: 0}}"
    )
    words = ["margin", "--study", file, "--seeds", "1", "--workers", "1", "--at-least", "1ms"]
    words = [*words, "--set", "funnel.rate_per_s=10"]  # else runs of 1 s are too short
    assert funnel_hil(*words, "--out", tmp_path / "out")[0] == 0
    output = funnel_hil.output(*words, "--pattern", "any", "--out", tmp_path / "out", code=3)
    assert "with compensation, margin to quote: 0 ms, must be at least 1 ms" in output
    assert len(list(Path(tmp_path / "out").glob("worst_pattern-000-*.csv"))) == 2
    output = funnel_hil.output(
        *words, "--baseline", tmp_path / "out", "--out", tmp_path / "new", code=2
    )
    assert "is a result of margin of delay, every pattern of delays: must be of" in output


@pytest.mark.parametrize(
    ("options", "asks"),
    [
        ({}, True),
        ({"study": "delay_margin"}, None),
        ({"at_least": "20ms"}, None),
        ({"baseline": Path("before")}, None),
        ({"plants": 3}, None),
        ({"what_helps": False}, False),
        ({"at_least": "20ms", "what_helps": True}, True),
    ],
)
def test_the_command_asks_what_helps_where_it_costs_little(options, asks):
    found = definition_with(MarginOptions(**options), {"what_helps": None})
    assert found.get("what_helps") is asks


@pytest.mark.parametrize(
    ("options", "asks"),
    [
        ({}, True),
        ({"at_least": "20ms"}, True),
        ({"baseline": Path("before")}, True),
        ({"plants": 3}, None),
        ({"study": "delay_margin"}, None),
        ({"at_least": "20ms", "smaller_rotors": False}, False),
    ],
)
def test_a_gate_is_on_the_margin_to_quote(options, asks):
    """A margin with a tenth of estimated rotors is the one to quote where it is smaller."""
    found = definition_with(MarginOptions(**options), {})
    assert found.get("smaller_rotors") is asks


ESTIMATE = {"robot.drive_data": "rotor inertia ESTIMATED as 0.008 kg m² per N m"}
ROTORS = "plant.actuator.rotor_inertia_kg_m2"


def by_rotors(run):
    """At a tenth of the rotors it holds up to 4 ms, and else up to 8 ms."""
    limit = 8.0 if run.columns["change"] is None else 4.0
    return made_up(run, **(LOST if run.columns["value"] > limit else {}))


def of_rotors(**values):
    given = {"limit": 12, "scenarios": ["panda_motors"], "set": ESTIMATE, "smaller_rotors": True}
    return margin_of(**{**PLAIN, "running": [False], **given, **values})


def test_estimated_rotors_have_a_margin_at_both_ends(tmp_path):
    study = of_rotors()
    whole, folder = conduct(study, tmp_path / "out", Here(by_rotors, seed=2))
    assert whole
    case, summary = case_of(study, folder), study.summary(folder.rows)
    assert summary["completed"]
    smaller = case["smaller_rotors"]
    assert (case["margin"], smaller["margin"], smaller["first_failure"]) == (8.0, 4.0, 8.0)
    own = study.cases[0].setting.base.scenario.plant.actuator.rotor_inertia_kg_m2
    (tried,) = {
        override for run in study.follow_ups[0]["rotors × 0.1"].variants
        for override in run.overrides if override.startswith(ROTORS)
    }  # fmt: skip
    assert tried == smaller["override"]
    assert json.loads(tried.partition("=")[2]) == pytest.approx(
        [0.1 * each for each in own], rel=5e-3
    )
    assert "8 ms with the estimated rotors, 4 ms with a tenth of them." in " ".join(
        margin_sentences(MarginResult.model_validate(summary))
    )
    table = margin_table(MarginResult.model_validate(summary))
    (column,) = [n for n, each in enumerate(table.columns) if "rotors" in each.title]
    assert [row[column] for row in table.rows] == ["4 ms"]


def test_a_margin_of_none_beside_a_value_that_held_has_a_sentence(tmp_path):
    def lost_with_small_rotors(run):
        is_lost = run.columns["change"] is not None or run.columns["value"] > 8.0
        return made_up(run, **(LOST if is_lost else {}))

    study = of_rotors()
    _, folder = conduct(study, tmp_path / "out", Here(lost_with_small_rotors))
    result = MarginResult.model_validate(study.summary(folder.rows))
    said = (
        "8 ms held on the arm as given, but the margin is none (with a tenth of the estimated"
        " rotors): it is the smallest result of all tests."
    )
    for sentences in (margin_sentences(result), brief_margin_sentences(result)):
        assert said in " ".join(sentences)


@pytest.mark.parametrize(
    "values",
    [{"set": {}}, {"set": {**ESTIMATE, ROTORS: 0.1}}, {"smaller_rotors": False}],
    ids=["data", "set", "not asked"],
)
def test_known_rotors_are_not_varied(tmp_path, values):
    study = of_rotors(**values)
    _, folder = conduct(study, tmp_path / "out", Here(by_rotors))
    assert {row["change"] for row in folder.rows} == {None}
    assert case_of(study, folder).get("smaller_rotors") is None
    table = margin_table(MarginResult.model_validate(study.summary(folder.rows)))
    assert not any("rotors" in each.title for each in table.columns)


@pytest.mark.parametrize(("option", "code"), [((), 3), (("--no-smaller-rotors",), 0)])
def test_a_gate_fails_by_smaller_rotors_alone(tmp_path, option, code):
    """Of an arm with estimated rotors, which holds at 96 ms, and with a tenth of them at 64 ms."""
    words = (
        "margin", "ur5e_motors", "--laws", "fixed_time_adaptive", "--compensation", "on",
        "--running", "off", "--resolution", "32", "--limit", "96", "--offsets", "1",
        "--duration", "3", "--workers", "1", "--at-least", "90ms", "--out", tmp_path,
    )  # fmt: skip
    output = output_of(*words, *option, code=code)
    (case,) = json.loads((tmp_path / "summary.json").read_text())["cases"]
    assert case["margin"] == 96.0
    if option:
        assert "gate: passed; with 96 ms" in output
        return
    assert (case["quoted"], case["quoted_because"]) == (64.0, "smaller rotors")
    assert case["smaller_rotors"]["margin"] == 64.0
    assert "with compensation: 64 ms, must be at least 90 ms" in output
