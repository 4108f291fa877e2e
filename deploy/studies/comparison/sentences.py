"""The verdict on several laws, in words."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from deploy.judge.findings.remedies import remedy_of
from deploy.judge.link_words import has_no_delay, link_words
from deploy.judge.result.section import PerJoint
from deploy.reports.page import ReportHead
from deploy.reports.tables import number
from deploy.reports.verdict_texts import (
    bounds_sentence,
    head_of_runs,
    is_sound,
    loss_words,
    recording_sentences,
)
from deploy.run.run_folder import RunFolder

if TYPE_CHECKING:
    from deploy.run.execute import JudgedRun
    from deploy.study.comparison.compared_runs import ComparedRuns
    from deploy.study.comparison.settling import SettlingTest


_NAMED_JOINTS = 2


def verdict_on_laws(comparison: ComparedRuns) -> ReportHead:
    """The verdict on a comparison."""
    runs = comparison.runs
    kept = sum(run.kept_bounds for run in runs)
    headline = f"{kept} of {len(runs)} laws kept their bounds"
    if all(is_sound(run) for run in runs) and kept in (0, len(runs)):
        headline = f"All {kept} laws kept their bounds" if kept else "No law kept its bounds"
    unread, settled = recording_sentences(runs), list(map(settling_sentence, comparison.settling))
    helped = [text for run in runs for text in _remedy_sentences(run, {each.law for each in runs})]
    conditions = _conditions(runs)
    found = [*unread, *helped, *_ranking(comparison), *settled]
    head = head_of_runs(runs, headline, found)
    faulted = [f"{run.law}: {bounds_sentence(run)}" for run in runs if run.result.faults]
    return replace(
        head,
        reasons=[*conditions, *head.reasons],
        printed=[*conditions, *unread, *helped, *settled, *faulted],
    )


def _conditions(runs: Sequence[JudgedRun]) -> list[str]:
    """Say at which delay laws were compared and with which gains, and what compares the rest."""
    setup = runs[0].data.setup
    laws = [run.data.setup.scenario.controller.law for run in runs]
    asked = f"{_scenario_file(runs[0])} --laws {','.join(map(shlex.quote, laws))}"
    at = f"on the same link ({link_words(setup.link)})"
    if dead_ms := setup.scenario.plant.actuator.delay_ms:
        at += f", with a dead time of the actuators of {dead_ms:g} ms"
    if has_no_delay(setup.scenario):
        at = "without a link delay, which says nothing about how much delay each survives"
    own = [law for law, run in zip(laws, runs, strict=True) if _gives_gains(law, run, runs)]
    gains = (
        f"Nothing records whether the scenario's gains of {', '.join(own)} were tuned alike"
        if own
        else "Their gains follow from the arm's inertia and were not tuned"
    )
    return [
        f"All laws were compared {at}. This compares their margins: funnel-hil margin {asked}",
        f"{gains}. This tunes all laws alike: funnel-hil tune {asked}",
    ]


def _gives_gains(law: str, run: JudgedRun, runs: Sequence[JudgedRun]) -> bool:
    """Whether the scenario gives a law's gains; a recorded run also has those it derived itself."""
    others = [each for each in runs if each is not run] or runs
    return any(each.data.setup.scenario.controller.gains.get(law) for each in others)


def _scenario_file(run: JudgedRun) -> str:
    """Return the scenario of a run as a command takes it."""
    file = None if run.path is None else RunFolder(run.path).scenario
    return shlex.quote(str(file)) if file is not None and file.exists() else "SCENARIO"


def _remedy_sentences(run: JudgedRun, compared: Collection[str]) -> list[str]:
    """Say how a law was lost for which something helps, and what."""
    loss = run.result.loss
    if loss is None or not (remedy := remedy_of(loss.reason, run.law, compared)):
        return []
    at_once = " without a delay" if loss.without_delay else ""
    return [f"{run.law} is lost{at_once}, {loss_words(loss)} ({loss.joint}): {remedy}."]


def settling_sentence(test: SettlingTest) -> str:
    """Say in one sentence how a law settled from near and far."""
    times = [start.settling_time_s for start in test.starts]
    known = [time for time in times if time is not None]
    farthest = number(max((start.distance_rad for start in test.starts), default=None))
    bound = "" if test.bound_s is None else f", bound {number(test.bound_s)} s"
    slowest = f", at most {number(max(known))} s" if known else ""
    return (
        f"{test.law}: settled from {len(known)} of {len(times)} starts of up to {farthest} rad"
        f"{slowest}{bound}"
    )


def _ranking(comparison: ComparedRuns) -> list[str]:
    """Name the most precise law that kept its bounds, joint by joint, and the smoothest."""
    kept = [run for run in comparison.runs if run.kept_bounds]
    sentences = []
    numbers: dict[str, dict[str, PerJoint | None]] = {
        "Smallest RMS error": {run.law: run.result.tracking.rms_rad for run in kept},
        "Smallest total variation of torque": {
            run.law: run.result.torque.total_variation_nm_per_s for run in kept
        },
    }
    for what, by_law in numbers.items():
        competing = {law: values for law, values in by_law.items() if values is not None}
        if len(competing) > 1:
            sentences.append(f"{what}: {_winners(competing, kept)}.")
    return sentences


def _winners(competing: dict[str, list[float]], kept: list[JudgedRun]) -> str:
    """Name the smallest number on each joint, and its distance from the next best."""
    names = kept[0].result.tracking.joint_names
    won: dict[str, dict[str, float]] = {}
    for joint, name in enumerate(names):
        first, second = sorted(competing, key=lambda law: competing[law][joint])[:2]
        ratio = competing[first][joint] / max(competing[second][joint], 1e-300)
        won.setdefault(first, {})[name] = ratio
    return "; ".join(
        f"{law} on {_joints(list(ratios), len(names))},"
        f" at most {number(max(ratios.values()))} × the next best"
        for law, ratios in won.items()
    )


def _joints(some: list[str], joints: int) -> str:
    if len(some) == joints:
        return "every joint"
    if len(some) <= _NAMED_JOINTS:
        return " and ".join(some)
    return f"{len(some)} of {joints} joints"
