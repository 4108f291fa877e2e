"""The line that says what a link did."""

from __future__ import annotations

import numpy as np

from deploy.judge.findings.link_delays import MeasuredDelays

LOST = np.nan


def test_line_on_a_link_names_the_most_losses_in_a_row() -> None:
    delays_ms = np.array([1.0, LOST, 1.0, LOST, LOST, LOST, 1.0, LOST])
    text = MeasuredDelays(np.arange(8.0), delays_ms).summary()
    assert text.startswith("8 messages in 7.0 s, lost 5 (31 to 86 %), up to 3 in a row, delay in")


def test_line_on_a_link_without_losses_names_none() -> None:
    assert "in a row" not in MeasuredDelays(np.arange(3.0), np.ones(3)).summary()
