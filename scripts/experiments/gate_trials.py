"""Rates of false alarms and missed regressions of a gate on the delay margin.

``python -m scripts.experiments.gate_trials [REPETITIONS]`` prints both counts. A repetition takes
another seed of the encoders' noise; a regression draws other gains for the law.
"""

from __future__ import annotations

import random
import sys
from typing import Any

import funnel_hil
from deploy.judge.gate import Gate
from deploy.reports.kinds import gauged

SCENARIO: dict[str, Any] = {
    "duration_s": 1.0,
    "plant.encoder.velocity_noise_rad_s": 1e-4,
    "plant.physics.engine": "mujoco",
}
LAW = "smc"
TOLERANCE_MS, WORTH_NOTICING_MS = 1.0, 2.0


def margin_of(seed: int, changes: dict[str, Any]) -> list[Any]:
    """The numbers that a gate looks at."""
    found = funnel_hil.margin(
        "paper_arm", SCENARIO | changes, laws=[LAW], seeds=[seed], resolution=1.0, limit=64.0
    )
    return gauged(found.summary)


def main(repetitions: int) -> None:
    """Count false alarms and missed regressions."""
    (before,) = margin_of(1, {})
    gate = Gate(baseline={before.name: before}, tolerance=TOLERANCE_MS)
    alarms = sum(bool(gate.failures(margin_of(seed, {}))) for seed in range(1, repetitions + 1))
    print(f"margin {before.text}; false alarms: {alarms} of {repetitions} other seeds")
    drawn, caught, missed = random.Random(1), 0, 0
    for _ in range(repetitions // 4):
        changes = {
            "plant.payload_kg": drawn.uniform(0.0, 20.0),
            "controller.model_scale": drawn.uniform(0.5, 1.0),
        }
        (after,) = margin_of(1, changes)
        assert before.value is not None
        fell = before.value - (after.value if after.value is not None else 0.0)
        if fell >= WORTH_NOTICING_MS:
            is_caught = bool(gate.failures([after]))
            caught, missed = caught + is_caught, missed + (not is_caught)
    print(f"regressions of {WORTH_NOTICING_MS:g} ms or more: {caught} caught, {missed} missed")


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 200)
