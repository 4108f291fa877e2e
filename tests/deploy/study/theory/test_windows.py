"""Windows of unstable delays, against eigenvalues of the whole loop at many delays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from deploy.study.theory.windows import unstable_windows
from tests.deploy.study.theory.lifted_loops import LiftedLoop, random_loop
from tests.deploy.study.theory.linear_arms import ARMS, RESONANT, constant, is_kept
from tests.warm_process import ROOT

PAGE = ROOT / "deploy" / "docs" / "explanation" / "theory.md"
PERIODS, BESIDE_S = 60, 1e-5
RUNS = [(2.0, 2.5), (8.0, 9.0), (14.0, 15.0), (67.0, 70.0)]
"""Delays before and in the first three windows and the last one of a gear, in ms."""


@pytest.mark.parametrize("seeds", [range(20), range(20, 40)])
def test_windows_are_where_an_eigenvalue_is_outside(seeds):
    for seed in seeds:
        loop, lifted = random_loop(seed)
        longest_s = PERIODS * loop.period_s
        windows = unstable_windows(loop, longest_s)
        edges = [edge for window in windows[:6] for edge in (window.begin_s, window.end_s)]
        beside = [edge + sign * BESIDE_S for edge in edges for sign in (-1.0, 1.0)]
        middles = [0.5 * (window.begin_s + window.end_s) for window in windows[:6]]
        anywhere = np.random.default_rng(seed).uniform(0.0, longest_s, 12)
        tried = [*anywhere, *middles, *(s for s in beside if 0.0 < s < longest_s - 2 * BESIDE_S)]
        for delay_s in tried:
            is_inside = any(window.begin_s < delay_s < window.end_s for window in windows)
            assert lifted.is_stable(delay_s) in (not is_inside, None), (seed, delay_s)


def test_a_gear_has_a_window_in_each_of_its_periods(tmp_path):
    arm = ARMS[RESONANT]
    file = arm.write(tmp_path)
    found = theory_of(load_setup(str(file)))
    windows = found["unstable_ms"]
    assert found["constant_ms"] == windows[0][0] == pytest.approx(2.17, abs=0.01)
    for begin, end in [*windows[:-1], [windows[-1][0], 200.0]]:
        inside = 0.5 * (begin + end)
        assert not arm.loop.is_stable([1e-3 * inside])
        for edge, sign in ((begin, 1.0), (end, -1.0))[: 1 + (end < 200.0)]:
            assert arm.loop.is_stable([1e-3 * (edge - sign * 0.02)]), edge
            assert not arm.loop.is_stable([1e-3 * (edge + sign * 0.02)]), edge
    assert windows[-1][1] is None
    assert len(windows) == 12
    text = PAGE.read_text()
    for (begin, end), (kept_ms, lost_ms) in zip([*windows[:3], windows[-1]], RUNS, strict=True):
        assert is_kept(file, constant(kept_ms)), kept_ms
        assert not is_kept(file, constant(lost_ms)), lost_ms
        shown = f"from {begin:g} ms on" if end is None else f"{begin:g} to {end:g} ms"
        assert f"| {shown} | {lost_ms:g} ms | {kept_ms:g} ms |" in text


def test_a_loop_that_is_unstable_without_a_delay_has_growth_frequency_and_joint(tmp_path):
    # Measured at the link, a resonance with little damping may need a delay to be damped.
    arm = replace(ARMS[RESONANT], gear=(0.1, 84220.6, 0.2), is_seen_at_link=True)
    found = theory_of(load_setup(str(arm.write(tmp_path))))
    loop = arm.loop
    none, rows = np.zeros((0, 2)), np.eye(4)[[1, 3]]
    law = np.zeros((0, 0)), none, none.T[:1], -np.array([[60.0, 10.8]])
    roots = LiftedLoop((loop.dynamics, loop.inputs, rows), law, loop.period_s).roots(0.0)
    exponent = np.log(roots[np.argmax(abs(roots))]) / loop.period_s
    without = found["unstable_without_delay"]
    assert without["rate_per_s"] == pytest.approx(exponent.real, rel=0.01)
    assert without["frequency_hz"] == pytest.approx(abs(exponent.imag) / 2.0 / np.pi, rel=0.01)
    assert without["joint"] == found["joint"] == "j0"
    assert (found["constant_ms"], found["any_pattern_ms"]) == (None, None)
    (first, last), *later = found["unstable_ms"]
    assert first == 0.0
    assert loop.is_stable([1e-3 * (last + 0.02)])
    assert not loop.is_stable([1e-3 * (last - 0.02)])
    assert later
