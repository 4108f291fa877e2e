"""Runs of arms whose loops are linear agree with exact theory, and `theory_of` with both."""

from __future__ import annotations

import pytest

from deploy.studies.margin.margin import Margin
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.sentences import margin_sentences
from deploy.studies.margin.theory_sentences import theory_sentences
from tests.deploy.study.studies import Here, conduct, made_up
from tests.deploy.study.theory.linear_arms import (
    ARMS,
    RESOLUTION_MS,
    UR10E,
    constant,
    exact_ms,
    is_kept,
    theory_ms,
)
from tests.warm_process import ROOT

PAGE = ROOT / "deploy" / "docs" / "explanation" / "theory.md"
README = ROOT / "README.md"


@pytest.mark.parametrize("name", ARMS)
def test_arm_is_kept_up_to_the_exact_margin_and_lost_one_step_beyond(name, tmp_path):
    file, largest = ARMS[name].write(tmp_path), RESOLUTION_MS * (exact_ms(name) // RESOLUTION_MS)
    assert is_kept(file, constant(largest))
    assert not is_kept(file, constant(largest + RESOLUTION_MS))


@pytest.mark.parametrize("name", ARMS)
def test_theory_of_a_scenario_is_that_of_the_exact_loop(name, tmp_path):
    assert theory_ms(name, tmp_path)["constant_ms"] == pytest.approx(exact_ms(name), abs=0.02)


def test_the_page_has_the_figures(tmp_path):
    table = ["| loop | exact | held | every pattern |", "|---|---|---|---|"]
    for name in ARMS:
        held_ms = RESOLUTION_MS * (exact_ms(name) // RESOLUTION_MS)  # as tested above
        bound_ms = theory_ms(name, tmp_path)["any_pattern_ms"]
        table.append(f"| {name} | {exact_ms(name):.2f} ms | {held_ms:g} ms | {bound_ms:.2f} ms |")
    assert "\n".join(table) in PAGE.read_text()
    counts = {11: "eleven", 12: "twelve", 13: "thirteen"}
    assert f"on {counts[len(ARMS)]} linear loops" in README.read_text()


def test_margin_prints_theory_beside_what_it_found(tmp_path):
    file = ARMS[UR10E].write(tmp_path)
    search = {"scenarios": [str(file)], "laws": ["pid", "smc"], "offsets": [1.0], "limit": 14}
    study = Margin(search, tmp_path)
    _, folder = conduct(study, tmp_path / "out", Here())
    summary = study.summary(folder.rows)
    pid, smc = summary["cases"]
    assert pid["margin"] == 13.5
    assert pid["theory"] == {
        "constant_ms": 13.54, "any_pattern_ms": 8.94, "joint": "j0",
        "unstable_ms": [[13.54, None]], "unstable_without_delay": None, "beside_ms": 0.0,
    }  # fmt: skip
    assert set(smc["theory"]) == {"reason", "beside_ms"}
    text = margin_sentences(MarginResult.model_validate(summary))
    assert any(
        "round trip up to 13.54 ms, and with every varying one below 8.94 ms" in s for s in text
    )
    (smc_has_none,) = (each for each in text if each.startswith("No theoretical margin for smc: "))
    assert "no slope at zero error" in smc_has_none


def test_other_quantities_than_delay_have_no_theory(tmp_path):
    study = Margin({"laws": ["pid"], "quantity": "jitter", "limit": 2}, tmp_path)
    _, folder = conduct(study, tmp_path / "out", Here(made_up))
    assert study.summary(folder.rows)["cases"][0]["theory"] is None


CASE = {
    "arm": "arm", "law": "pid", "compensation": None, "drive_feedback": None, "running": False,
}  # fmt: skip
SENTENCES = {
    "stable with every constant round trip up to 2.17 ms, and with every varying one below 1.66 ms"
    " (linear, the arm at its start, viscous friction alone; weakest: j0); unstable from 2.17 to"
    " 3 ms, 8.33 to 9.37 ms, 14.49 to 15.7 ms, and so on (4 windows)": {
        "constant_ms": 2.17, "any_pattern_ms": 1.66, "joint": "j0", "unstable_without_delay": None,
        "unstable_ms": [[2.17, 3.0], [8.33, 9.37], [14.49, 15.7], [20.64, None]],
    },
    "unstable without a delay: it grows by 1.2/s at 160 Hz (linear, the arm at its start, viscous"
    " friction alone; j0 moves most)": {
        "constant_ms": None, "any_pattern_ms": None, "joint": "j0", "unstable_ms": [[0.0, None]],
        "unstable_without_delay": {"rate_per_s": 1.2, "frequency_hz": 160.0, "joint": "j0"},
    },
    "unstable without a delay: it grows by 10/s without swinging (linear, the arm at its start,"
    " viscous friction alone; j0 moves most)": {
        "constant_ms": None, "any_pattern_ms": None, "joint": "j0", "unstable_ms": [[0.0, None]],
        "unstable_without_delay": {"rate_per_s": 10.0, "frequency_hz": 0.0, "joint": "j0"},
    },
    "stable with every constant round trip up to 1000 ms, and with every varying one below 7 ms"
    " (linear, the arm at its start, viscous friction alone)": {
        "constant_ms": 1000.0, "any_pattern_ms": 7.0, "joint": None, "unstable_ms": [],
        "unstable_without_delay": None,
    },
}  # fmt: skip


@pytest.mark.parametrize("sentence", SENTENCES)
def test_sentences_say_what_theory_found(sentence):
    (found,) = theory_sentences(
        MarginResult.model_validate(
            {"unit": "ms", "cases": [{**CASE, "theory": SENTENCES[sentence]}]}
        )
    )
    assert found == f"arm, pid: in theory {sentence}."
