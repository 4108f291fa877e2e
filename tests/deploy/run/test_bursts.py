"""A burst of late states, or commands, that arrive at one instant does not throw the arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages import topics
from deploy.judge.bounds import bound_usage
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
AT_S, RETURN_S = 2.0, 1.0


def with_burst(folder: Path, burst_ms: int) -> str:
    """A trace of 60 s with a delay of 5 ms, and one burst whose messages arrive at one instant."""
    delays_ms = np.full(60_000, 5.0)
    first = round(1e3 * AT_S)
    delays_ms[first : first + burst_ms] = np.maximum(5.0, burst_ms - np.arange(burst_ms))
    rows = [f"{1e-3 * tick:.3f},{delay}" for tick, delay in enumerate(delays_ms)]
    file = folder / "burst.csv"
    file.write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    return f"{{file: {file}, start_s: 0}}"


@pytest.mark.parametrize(
    ("arm", "side", "burst_ms", "most_bounds"),
    [
        ("panda_motors", "uplink", 150, 0.2),  # 1.8 where d grew to the burst's delay
        ("panda_motors", "downlink", 500, 3.0),  # 5.8 without a bridge
        ("ur5e_motors", "uplink", 500, 1.5),  # 3.1 without a bridge
        ("panda", "uplink", 150, 3.0),  # light wrists; 26 where d grew
    ],
)
def test_an_arm_deviates_little_and_returns_within_a_second(
    tmp_path, arm, side, burst_ms, most_bounds
):
    """d jumped to the burst's delay, so that no new torque acted for just as long once more."""
    other = "downlink" if side == "uplink" else "uplink"
    run = simulate(
        load_setup(
            arm,
            [
                ON, f"link.{side}.trace={with_burst(tmp_path, burst_ms)}",
                f"link.{other}.delay_ms=5", "plant.command_timeout_ms=1000",
                f"duration_s={AT_S + 1e-3 * burst_ms + RETURN_S + 0.1}",
            ],
        )
    ).data()  # fmt: skip
    since_s = run.times_s(topics.PLANT_TRUTH) - AT_S
    usage = bound_usage(run).max(axis=1)[since_s >= 0.0]
    assert usage.max() < most_bounds
    assert usage[since_s[since_s >= 0.0] > 1e-3 * burst_ms + RETURN_S].max() < 1.0
