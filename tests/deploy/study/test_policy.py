"""The command `policy`: inference times that merges of chunks tolerate."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import funnel_hil as funnel_hil_api
from deploy.judge.run_rows import failed_row
from deploy.reports.tables import shown_in
from deploy.scenario.scenario import load_setup
from deploy.studies.policy.findings import jump_column, longest, merge_findings, recommended
from deploy.studies.policy.page import advice
from deploy.studies.policy.policy import PolicyStudy
from deploy.studies.policy.result import Merge, Point, PolicyResult
from tests.one_joint import policy_setup

CHUNKS = "controller.chunks={horizon: 16, period_ms: 20, ask_every: 8}"
TASKS = {
    "reference": {
        "kind": "reach", "centre_rad": 0.0, "spread_rad": 0.5, "amplitude_rad": 0.3,
        "frequency_rad_s": 2.5, "reach_s": 0.5,
    },
    "controller.gains.custom": {"actions": 16, "period_s": 0.02},
    "controller.between_answers": "linear",
    "controller.chunks": {"horizon": 16, "period_ms": 20, "ask_every": 8},
}  # fmt: skip
SHORT = ("--set", CHUNKS, "--set", "duration_s=2")
BOUNDS = ("--limit", "240", "--resolution", "40", "--workers", "1")


def test_perfect_chunks_are_tolerated_until_they_run_out(tmp_path, funnel_hil):
    """A chunk lasts 320 ms; an answer that takes d > 160 ms is in force for 2 d after its question.

    At 200 ms the arm rests for 80 ms, 40 of 60 mrad at 0.5 rad/s; at 240 ms for 160 ms, 80 mrad.
    The frozen prefix takes at most half of its chunk.
    """
    policy_setup(tmp_path, CHUNKS, rows=16, spacing_s=0.02, knows_velocity=True, funnel_rad=0.06)
    out = tmp_path / "out"
    words = ("policy", "tests.joint_laws:Policy", tmp_path / "one.yaml", "--out", out)
    words = (*words, "--merges", "replace,frozen_prefix", *SHORT, *BOUNDS)
    shown = funnel_hil.output(*words, "--at-least", "150 ms")
    found = json.loads((out / "summary.json").read_text())
    replaced, frozen = found["cases"]
    assert (replaced["inference_ms"], replaced["ends"]) == (200.0, "chunk ran out")
    assert (frozen["inference_ms"], frozen["is_limit"]) == (160.0, True)
    assert max(each["at"]["jump_rad"] for each in found["cases"]) < 1e-6
    assert replaced["at"]["age_largest_ms"] == 100.0 + 8 * 20.0 - 1.0
    text = " ".join(shown.split())
    assert "one: at an inference time of 100 ms use replace Its chunks jump by" in text
    assert "It keeps the bounds up to 200 ms." in text
    table = (out / "table.md").read_text()
    assert "frozen_prefix | 160 | limit of the merge" in table
    assert "Limit of the merge: a longer inference" in table
    assert "jumps-0" in (out / "report.html").read_text()
    again = funnel_hil.output(*words, "--at-least", "180 ms", code=3)
    assert "14 of 14 runs, 14 runs were there from before" in again
    assert "frozen_prefix, inference time: 160 ms, must be at least 180 ms" in again
    too_rough = funnel_hil.output(*words, "--at-least", "0.001 rad/s3", code=3)
    assert "replace, jerk at 100 ms" in too_rough


def test_margin_of_each_task_from_python(tmp_path):
    """Chunks of 160 ms: tasks at rest keep their bounds with any inference time, others do not.

    Two tasks are two references, so that the spread over them is that of their own runs.
    """
    setup = policy_setup(tmp_path, CHUNKS, funnel_rad=0.06)
    study = funnel_hil_api.policy(
        "funnel_hil:Demonstrator", [str(setup.source)], merges=["replace"], tasks=3, out=tmp_path,
        limit_ms=300, resolution_ms=100, set={**TASKS, "duration_s": 1.4},
    )  # fmt: skip
    [case] = study.summary["cases"]
    of_tasks = case["of_tasks_ms"]
    alone = []
    for task in (1, 2, 3):
        found = funnel_hil_api.policy(
            "funnel_hil:Demonstrator", [str(setup.source)], merges=["replace"], limit_ms=300,
            resolution_ms=100, set={**TASKS, "duration_s": 1.4, "reference.task": task},
        ).summary["cases"][0]  # fmt: skip
        alone.append(found["inference_ms"])
    assert of_tasks["smallest"] == min(alone) == case["inference_ms"]
    assert (of_tasks["median"], of_tasks["largest"]) == (sorted(alone)[1], max(alone))
    assert len(set(alone)) > 1
    assert case["ends"] == "chunk ran out"


@pytest.mark.parametrize("command", ["policy", "margin"])
def test_a_policy_with_another_number_of_rows_is_refused_before_any_run(
    tmp_path, funnel_hil, command
):
    policy_setup(tmp_path, CHUNKS, rows=10, spacing_s=0.02, knows_velocity=True)
    out, law = tmp_path / "out", "tests.joint_laws:Policy"
    words = {
        "policy": ("policy", law, tmp_path / "one.yaml"),
        "margin": (
            "margin", tmp_path / "one.yaml", "--laws", law, "--quantity", "controller.inference_ms",
            "--resolution", "40", "--limit", "240",
        ),
    }  # fmt: skip
    found = " ".join(funnel_hil.output(*words[command], *SHORT, "--out", out, code=2).split())
    assert f"controller.law = '{law}': an answer has 10 rows: must be 16, as" in found
    assert "runs/s" not in found
    assert not out.exists()


def test_unknown_merges_are_refused(funnel_hil, tmp_path):
    words = ("policy", "smc", "paper_arm", "--out", tmp_path / "out")
    assert "did you mean" in funnel_hil.output(*words, "--merges", "replac", code=2)
    assert "must be a list of different values" in funnel_hil.output(
        *words, "--merges", "spline,spline", code=2
    )


def test_tasks_are_refused_for_a_reference_without_them(funnel_hil, tmp_path):
    policy_setup(tmp_path, CHUNKS)
    words = ("policy", "tests.joint_laws:Policy", tmp_path / "one.yaml", "--tasks", "2")
    assert "reference" in funnel_hil.output(*words, code=2)


def case(merge, time_ms, jump_mm, jump_rad=0.1, jerk=1.0):
    """Return a merge, and its runs at 100 ms."""
    figures = {"jump_mm": jump_mm, "jump_rad": jump_rad, "jerk_rms_rad_s3": jerk}
    at = Point(
        inference_ms=100.0, runs=1, runs_kept=1, ends=None, worst_point="000",
        **dict.fromkeys(shown_in(Point)) | figures,
    )  # fmt: skip
    return Merge(
        arm="arm", merge=merge, is_whole=True, inference_ms=time_ms, is_limit=False, ends=None,
        of_tasks_ms=None, at=at, points=[at],
    )  # fmt: skip


def test_the_merge_that_jumps_least_at_the_inference_time_asked_for_is_recommended():
    """Of equals the one with the least jerk. One that keeps the bounds longer may jump more."""

    longer = case("a", 300.0, 2.0, jerk=1.0)
    rows = [longer, case("b", 100.0, 1.0, jerk=9.0), case("c", 150.0, 1.0, jerk=3.0)]
    lost = [case("d", None, 0.0, jerk=0.0), case("e", 50.0, 0.0, jerk=0.0)]
    assert recommended([*rows, *lost]).merge == "c"
    assert longest([*rows, *lost]) is longer
    assert recommended(lost).merge == "e"
    assert recommended(lost[:1]) is None


@pytest.mark.parametrize(("kept", "ends", "said"), [
    ({0.0: 0, 25.0: 1, 50.0: 1}, "lag",
     "no inference time to quote: at 0 ms it is lost (lag); bounds are kept at up to 50 ms"),
    ({0.0: 1, 25.0: 1}, "vibration",
     "at 0 ms bounds are kept but it does not hold (vibration); bounds are kept at up to 25 ms"),
    ({0.0: 1}, "vibration", "(vibration). Compare the velocities in the answers with the slope"),
    ({0.0: 0, 25.0: 0}, "saturated",
     "no merge keeps the bounds, even at an inference time of 0 ms (saturated)"),
    ({0.0: 0, 25.0: 0}, "robot's lag",
     "(robot's lag). Send each target earlier by that lag, make the robot's own loop faster"),
])  # fmt: skip
def test_a_policy_without_a_time_to_quote_says_what_its_runs_did(kept, ends, said):
    merge = case("replace", None, 0.0)
    points = [
        merge.at.model_copy(update={"inference_ms": time_ms, "runs_kept": count, "ends": ends})
        for time_ms, count in kept.items()
    ]
    result = PolicyResult.model_construct(
        completed=True, policy="m:P", cases=[merge.model_copy(update={"points": points})]
    )
    assert said in " ".join(advice(result, "arm", "funnel-hil simulate {}.yaml".format))


@pytest.mark.parametrize(("used", "said"), [
    (1.2, "There, the error with replace reaches 1.2 times its bound, 5 mm at the tip (RMS)."),
    (1.2, "If your task allows that error, widen the bound: --set funnel.final_rad="),
    (9.0, "the policy's answers in the report of one run: funnel-hil simulate 000.yaml"),
])  # fmt: skip
def test_a_policy_lost_at_once_says_by_how_much(used, said):
    merge = case("replace", None, 0.0)
    own = {"inference_ms": 0.0, "runs_kept": 0, "ends": "saturated", "bound_used": used}
    points = [merge.at.model_copy(update={**own, "tip_error_rms_mm": 5.0})]
    result = PolicyResult.model_construct(
        completed=True, policy="m:P", cases=[merge.model_copy(update={"points": points})]
    )
    assert said in " ".join(advice(result, "arm", "funnel-hil simulate {}.yaml".format))


def test_a_network_that_is_the_cause_is_named_after_one_more_run(tmp_path, funnel_hil):
    """Targets that are 0.4 s late are 0.2 rad off at 0.5 rad/s."""
    policy_setup(tmp_path, CHUNKS, rows=16, spacing_s=0.02, knows_velocity=True, funnel_rad=0.06)
    (tmp_path / "slow.csv").write_text("time_s,delay_ms\n0,400\n1,400\n2,400\n")
    words = ("policy", "tests.joint_laws:Policy", tmp_path / "one.yaml", "--out", tmp_path / "out",
             "--network", tmp_path / "slow.csv", "--merges", "replace", *SHORT, "--limit", "80",
             "--resolution", "40", "--workers", "1")  # fmt: skip
    shown = " ".join(funnel_hil.output(*words).split())
    assert "no merge keeps the bounds, even at an inference time of 0 ms" in shown
    assert "slow.csv, replace holds: the network is the cause" in shown
    assert "4 of 4 runs, 4 runs were there from before" in funnel_hil.output(*words)


@pytest.mark.parametrize(("arms", "said"), [(["arm"], "try a drive loop"), ([], "answers in")])
def test_late_commands_are_no_matter_of_the_horizon(arms, said):
    merge = case("replace", None, 0.0)
    own = {"inference_ms": 0.0, "runs_kept": 0, "ends": "late command", "bound_used": 9.0}
    points = [merge.at.model_copy(update=own)]
    result = PolicyResult.model_construct(
        completed=True, policy="m:P", cases=[merge.model_copy(update={"points": points})],
        torque_arms=arms,
    )  # fmt: skip
    found = " ".join(advice(result, "arm", "funnel-hil simulate {}.yaml".format))
    assert said in found
    assert "horizon" not in found


def test_only_runs_at_longer_inference_times_end_at_their_loss(tmp_path):
    setup = policy_setup(tmp_path, CHUNKS)
    given = {"scenarios": [str(setup.source)], "merges": ["replace"], "resolution_ms": 100}
    runs = list(PolicyStudy(given, Path("policy")).first())
    assert [run.ends_early for run in runs] == [False, True, True, True]


def test_a_policy_that_is_lost_at_the_time_of_comparisons_names_the_time_that_it_keeps():
    best = case("replace", 50.0, 0.0).model_copy(update={"ends": "vibration"})
    cases = [best, case("spline", None, 0.0)]
    result = PolicyResult.model_construct(completed=True, policy="m:P", cases=cases)
    first, help_ = advice(result, "arm", "funnel-hil simulate {}.yaml".format)
    assert first == (
        "arm: replace holds longest, up to 50 ms of inference. At 100 ms bounds are kept but no"
        " merge holds (vibration)."
    )
    assert help_.startswith("Compare the velocities")
    lost = [
        each.model_copy(update={"at": each.at.model_copy(update={"runs_kept": 0}), "ends": "jump"})
        for each in cases
    ]
    result = PolicyResult.model_construct(completed=True, policy="m:P", cases=lost)
    assert advice(result, "arm", "funnel-hil simulate {}.yaml".format)[0].endswith(
        "At 100 ms no merge keeps the bounds (jump)."
    )


def test_a_flaw_of_a_kept_run_is_named():
    flawed = failed_row(1, "") | {"inference_ms": 0.0, "arm": "arm", "merge": "replace",
        "error": None, "verdict": "kept", "vibrating": True, "point": "0"}  # fmt: skip
    found = merge_findings("arm", "replace", [flawed], [0.0], 0.0, is_whole=True)
    assert (found.inference_ms, found.ends) == (None, "vibration")
    assert found.points[0].runs_kept == 1


def test_one_unit_serves_all_merges_of_an_arm():
    """Where the tip stays, joints decide, and no jump in mm is compared with one in rad."""

    moved = [case("a", 100.0, 0.0, 6e-4), case("b", 100.0, 5e-4, 5e-7)]
    assert jump_column(moved) == "jump_mm"
    assert recommended(moved).merge == "a"
    still = [case("a", 100.0, 0.0, 6e-4), case("b", 100.0, 0.0, 5e-7)]
    assert jump_column(still) == "jump_rad"
    assert recommended(still).merge == "b"


def test_arms_of_one_name_are_refused(funnel_hil, tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        policy_setup(tmp_path / folder, CHUNKS)
    files = [tmp_path / folder / "one.yaml" for folder in ("a", "b")]
    words = ("policy", "tests.joint_laws:Policy", *files, *SHORT, "--out", tmp_path / "out")
    assert "must have different names" in funnel_hil.output(*words, code=2)


def test_no_inference_time_is_left_out(funnel_hil, tmp_path):
    policy_setup(tmp_path, CHUNKS)
    words = ("policy", "tests.joint_laws:Policy", tmp_path / "one.yaml", "--resolution", "0.1")
    assert "resolution_ms = 0.1" in funnel_hil.output(*words, code=2)


def test_a_servers_own_time_is_refused(funnel_hil, tmp_path):
    policy_setup(tmp_path, CHUNKS)
    measured = ("--set", "controller.policy_server.inference=measured", *SHORT)
    words = ("policy", "openpi://127.0.0.1:1", tmp_path / "one.yaml", *measured)
    assert "controller.policy_server.inference" in funnel_hil.output(*words, code=2)


def test_the_file_of_an_arm_gets_an_interface_and_chunks_which_options_change():
    arm = str(load_setup("ur5e_motors").robot.path)
    given = {"scenarios": [arm], "law": "funnel_hil:Demonstrator", "merges": ["replace"]}
    [base] = PolicyStudy(given, Path("policy")).bases
    assert base.scenario.plant.interface.kind == "servoj"
    assert (base.scenario.controller.chunks.horizon, base.scenario.funnel.final_rad[0]) == (
        16,
        0.08,
    )
    [base] = PolicyStudy({**given, "set": {"controller.chunks.horizon": 8}}, Path("policy")).bases
    assert base.scenario.controller.chunks.horizon == 8
