"""The studies of a data sheet: how much delay an arm takes, on a network, as uncertain plants."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy.judge.run_rows import Row
from deploy.judge.tested_with import STUDY
from deploy.scenario import study_keys
from deploy.scenario.referenced_files import TRACES
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.margin.margin_study import margin_study
from deploy.studies.sweep.sweep import Sweep
from deploy.study.settings import COMPENSATION, DRIVE_FEEDBACK
from deploy.study.statistics import badness
from deploy.study.study import StudyOfRuns
from plant_emulator.channel.trace_file import Trace, read_trace

Test = dict[str, dict[str, Any]]
_SOURCE = Path("datasheet")
START_KEYS = "link.uplink.trace.start_s, link.downlink.trace.start_s"
_STRETCH_NS, _LEAD_NS = 500_000_000, 250_000_000
"""Length of the worst stretch of a network, and how long before it a window begins."""
_MODEL_ERRORS = (0.8, 1.25)
"""Factors on the model's masses and inertias, as far as those of an unidentified arm err."""
_SHARES_OF_MARGIN = (0.25, 0.5, 0.75, 1.0)


class Sheet:
    """Base of the settings of data sheets."""

    network: str | None
    fixed: Mapping[str, Any] | None
    is_quick: bool
    network_windows: int | None

    @property
    def duration_s(self) -> float:
        """Length of each run."""
        given: float | None = (self.fixed or {}).get("duration_s")
        return (3.0 if self.is_quick else 6.0) if given is None else given

    def windows_of(self, network: str) -> tuple[str, list[float]]:
        """Return the file or name of a network, and where its windows begin."""
        file = Path(network)
        name = str(file.resolve()) if file.is_file() else network
        return name, window_starts_s(name, self.network_windows or (5 if self.is_quick else 12))

    @property
    def all_set(self) -> dict[str, Any]:
        """Values of the scenario that were set, by dotted key."""
        return dict(self.fixed or {})

    def _set(self) -> dict[str, Any]:
        return {key: each for key, each in (self.fixed or {}).items() if key != "duration_s"}


@dataclass(frozen=True)
class DataSheet(Sheet):
    """Settings of a data sheet.

    Attributes:
        arm: a scenario, or the file of an arm.
        law: its control law.
        network: a file of delays, or the name of a shipped trace; None for none.
        plants: number of uncertain plants; 0 for none.
        fixed: values of the scenario, by dotted key.
        is_quick: shorter and fewer runs.
        network_windows: number of windows of the network; None for 12, or 5 with `is_quick`.
    """

    arm: str
    law: str
    network: str | None = None
    plants: int = 0
    fixed: Mapping[str, Any] | None = None
    is_quick: bool = False
    network_windows: int | None = None

    def tested_with(self, margin: Test | None) -> Test | None:
        """Return its test from that of its search for margins, which older versions lack."""
        return margin and {**margin, STUDY: {**margin[STUDY], "plants": self.plants}}

    def margin(self) -> StudyOfRuns:
        """Return the search for margins, without and with delay compensation, for any pattern."""
        quick: dict[str, Any] = {
            "seeds": [1], "offsets": [1.0], "disturbances": None, "thorough": False
        }  # fmt: skip
        values = {
            "name": "margin", "scenarios": [self.arm], "laws": [self.law], "running": [False],
            "compensation": [False, True], "pattern": "any", "what_helps": True,
            "smaller_rotors": True, "model_errors": list(_MODEL_ERRORS),
            "duration_s": self.duration_s, "set": self._set(),
        }  # fmt: skip
        return margin_study(values | (quick if self.is_quick else {}), _SOURCE)

    def windows(self) -> StudyOfRuns | None:
        """Return runs on windows of the network; None without a network.

        With compensation first; also without, and each with a drive loop where that is
        possible and not fixed. Both directions begin at the same place of the network.
        """
        if self.network is None:
            return None
        name, starts_s = self.windows_of(self.network)
        grid: dict[str, list[Any]] = {
            ", ".join(study_keys.TRACES): [name], START_KEYS: starts_s,
            COMPENSATION: [True, False], DRIVE_FEEDBACK: [False, True],
        }  # fmt: skip
        given = {study_keys.LAW: self.law, "duration_s": self.duration_s, **self._set()}
        values = {
            "name": "network", "scenario": self.arm, "grid": grid, "seeds": 1, "set": given,
        }  # fmt: skip
        if DRIVE_FEEDBACK not in given:
            with contextlib.suppress(ScenarioError):
                return Sweep(values, _SOURCE)
        del grid[DRIVE_FEEDBACK]
        return Sweep(values, _SOURCE)

    @property
    def plants_at_most(self) -> int:
        """Largest number of runs of uncertain plants."""
        return self.plants * len(_SHARES_OF_MARGIN)

    def of_plants(self, margin_ms: float) -> StudyOfRuns | None:
        """Return runs of uncertain plants at parts of a margin; None without plants or margin."""
        values_ms = sorted({round(2.0 * part * margin_ms) / 2.0 for part in _SHARES_OF_MARGIN})
        if not self.plants or not values_ms[-1]:
            return None
        values = {
            "name": "plants", "scenarios": [self.arm], "laws": [self.law], "running": [False],
            "compensation": [True], "plants": self.plants, "uncertainty": "half",
            "values": [value for value in values_ms if value], "duration_s": self.duration_s,
            "set": self._set(),
        }  # fmt: skip
        return margin_study(values, _SOURCE)


def worst_window(rows: list[Row]) -> Row:
    """Return the worst run on a network with compensation alone.

    Of windows that it keeps alike, that which is worst without compensation.
    """
    start, _ = START_KEYS.split(", ")
    alone = [row for row in rows if not row.get(DRIVE_FEEDBACK)]
    bare = {row.get(start): row for row in alone if not row[COMPENSATION]}

    def of_window(row: Row) -> tuple[Any, ...]:
        without = bare.get(row.get(start), row)
        return badness(row), badness(without), -(without.get("margin_min") or 0.0)

    return max((row for row in alone if row[COMPENSATION]), key=of_window)


def network_files(network: str | None) -> list[Path]:
    """Return the file of a network; none for a shipped one."""
    return [] if network is None or not Path(network).is_file() else [Path(network)]


def window_starts_s(network: str, count: int) -> list[float]:
    """Return where windows of a trace begin: spread over it, and just before its worst stretch.

    Args:
        network: its file, or the name of a shipped one; what cannot be read is refused later.
        count: how many, at least 2.
    """
    trace = _trace_of(network)
    if trace is None:
        return [0.0]
    delays_ns = np.where(trace.delays_ns < 0, trace.delays_ns.max(), trace.delays_ns)
    sums_ns = np.concatenate([[0.0], np.cumsum(delays_ns, dtype=np.float64)])
    ends = np.searchsorted(trace.times_ns, trace.times_ns + _STRETCH_NS)
    means_ns = (sums_ns[ends] - sums_ns[:-1]) / (ends - np.arange(len(ends)))
    worst_ns = max(0, int(trace.times_ns[means_ns.argmax()]) - _LEAD_NS)
    spread_ns = np.arange(count - 1) * trace.length_ns / (count - 1)
    return sorted({round(1e-9 * each, 3) for each in (*spread_ns.tolist(), worst_ns)})


def smooth_playout_ms(network: str) -> float | None:
    """Return a play-out in which 99 % of the round trips over a network end, in whole 10 ms."""
    trace = _trace_of(network)
    if trace is None:
        return None
    arrived_ns = trace.delays_ns[trace.delays_ns >= 0]
    return 10.0 * math.ceil(0.1e-6 * 2.0 * float(np.quantile(arrived_ns, 0.99)))


def _trace_of(network: str) -> Trace | None:
    """Return a trace by its file, or the name of a shipped one; None for what cannot be read."""
    file = Path(network)
    try:
        return read_trace(file if file.is_file() else TRACES / f"{network}.parquet")
    except (OSError, ValueError):
        return None
