"""Cycles over CAN can be measured: every side, bus and size has its cost, and the drives follow."""

from __future__ import annotations

import pytest

from scripts.benchmarks import can_cycle


def test_every_side_is_set_beside_the_bare_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_cycle, "SIZES", (1, 2))
    section = can_cycle.measure_can_cycles(cycles=3, repetitions=1)
    named = {ratio.name for ratio in section.ratios}
    for bus in ("virtual", "udp_multicast"):
        for side in ("master", "drives"):
            name = f"{side}, {bus}, 2 drives"
            assert f"{name} / bare {name}" in named
            assert f"{name} / {side}, {bus}, 1 drives" in named
    assert all(cost.lowest > 0.0 for cost in section.costs_us.values())


def test_compiled_cycle_carries_its_frames() -> None:
    assert can_cycle.compiled_cycle_us(2, cycles=5) > 0.0
