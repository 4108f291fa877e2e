"""The margin in virtual time beside what is left of it over a real delay.

``python -m scripts.experiments.real_delay paper_arm --set duration_s=10
--round-trips 48,64 --repetitions 3 --out FOLDER`` simulates the scenario once with each round trip,
constant and half of it each way, and runs it several times in real time, one run after another,
over a relay that holds every byte back for as long (`deploy.run.processes.relay`). A run
that was held up for more than 20 ms is counted apart: it says something of the host.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.errors import InputError
from bus_schema.messages import topics
from bus_schema.recording.atomic_files import write_json, write_whole
from deploy.judge.findings.stalls import STALL_MS
from deploy.run.execute import InProcess, InProcesses, JudgedRun, execute
from deploy.run.exit_codes import BAD_INPUT
from deploy.run.network.links import check_link, require_keys, with_free_endpoints
from deploy.run.network.real_delay import check_real_delay, knowing_real_delay, real_delay
from deploy.run.run_folder import RunFolder, RunFolderError, provenance
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, override

_SETTLED_S = 0.5
"""From here on the horizon is judged: what comes before is its start."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one run.

    Attributes:
        kept: it came to its end, and its errors stayed inside the funnel.
        margin_min: smallest distance to the bound as a share of it; None without data.
        first_violation_s: when an error left the funnel; None if none did.
        round_trip_ms: percentiles from a state to the arrival of its answer at the plant.
        horizon_ms: median of the controller's estimate, from 0.5 s on; None without compensation.
        horizon_jitter_ms: between its 1st and 99th percentile.
        longest_stall_ms: see `deploy.judge.findings.stalls`; None in virtual time.
        faults: what went wrong.
    """

    kept: bool
    margin_min: float | None
    first_violation_s: float | None
    round_trip_ms: dict[str, float | None]
    horizon_ms: float | None
    horizon_jitter_ms: float | None
    longest_stall_ms: float | None
    faults: list[str]

    @property
    def was_held_up(self) -> bool:
        return self.longest_stall_ms is not None and self.longest_stall_ms > STALL_MS


@dataclass(frozen=True)
class Row:
    """A round trip: in virtual time, and over a real delay."""

    round_trip_ms: float
    virtual: Outcome
    real: list[Outcome]


def outcome_of(judged: JudgedRun) -> Outcome:
    """Return the outcome of a run for the table."""
    run, summary = judged.data, judged.summary
    bounds, timing = summary["bounds"], summary["timing"]
    status = run.tables[topics.CONTROL_STATUS.name]
    is_settled = run.times_s(topics.CONTROL_STATUS) >= _SETTLED_S
    horizons_ms = status["horizon_ns"][is_settled] * 1e-6
    compensates = run.setup.scenario.controller.delay_compensation.enabled and len(horizons_ms) > 0
    low, middle, high = np.percentile(horizons_ms, (1, 50, 99)) if compensates else (0.0,) * 3
    round_trips = {
        name: None if value is None else 1e-3 * value
        for name, value in timing["round_trip_us"].items()
    }
    return Outcome(
        kept=bounds["kept"],
        margin_min=bounds["margin_min"],
        first_violation_s=bounds["first_violation_s"],
        round_trip_ms=round_trips,
        horizon_ms=float(middle) if compensates else None,
        horizon_jitter_ms=float(high - low) if compensates else None,
        longest_stall_ms=timing["longest_stall_ms"],
        faults=summary["faults"],
    )


def in_virtual_time(scenario: str, overrides: Sequence[str], round_trip_ms: float) -> Outcome:
    """Simulate with so much more delay on the link, half of it each way."""
    link = load_setup(scenario, overrides).scenario.link
    delays = [
        override(f"link.{name}.delay_ms", channel.delay_ms + 0.5 * round_trip_ms)
        for name, channel in (("uplink", link.uplink), ("downlink", link.downlink))
    ]
    return outcome_of(execute(load_setup(scenario, [*overrides, *delays]), InProcess()))


def over_real_delay(setup: Setup, round_trip_ms: float, folder: Path) -> Outcome:
    """Run in real time as `run --real-delay` does."""
    setup = with_free_endpoints(knowing_real_delay(setup, round_trip_ms))
    files = RunFolder.begin(setup, folder, overwrite=True)
    run = execute(setup, InProcesses(real_delay(setup, round_trip_ms)), files)
    try:
        run.keep(files)
    except RunFolderError as error:
        unknown = dict.fromkeys(("p50", "p99", "p99_9", "max"))
        faults = [*run.outcome.failures, str(error)]
        return Outcome(False, None, None, unknown, None, None, None, faults)
    return outcome_of(run)


def rows(
    scenario: str,
    overrides: Sequence[str],
    round_trips_ms: Sequence[float],
    repetitions: int,
    out: Path,
) -> Iterator[Row]:
    """A row per round trip, with a line for each run on the way.

    Raises:
        InputError: the scenario cannot be run so; before anything starts.
    """
    setup = load_setup(scenario, overrides)
    for round_trip_ms in round_trips_ms:
        check_real_delay(setup, round_trip_ms)
    check_link(setup, one_process=False)
    require_keys(setup, *topics.Role)
    for round_trip_ms in round_trips_ms:
        virtual = in_virtual_time(scenario, overrides, round_trip_ms)
        _say(f"{round_trip_ms:g} ms, virtual time: {_verdict(virtual)}")
        real = []
        for number in range(1, repetitions + 1):
            folder = out / f"{round_trip_ms:g}-ms-{number}"
            real.append(over_real_delay(setup, round_trip_ms, folder))
            _say(f"{round_trip_ms:g} ms, run {number} of {repetitions}: {_verdict(real[-1])}")
        yield Row(round_trip_ms, virtual, real)


HEADINGS = (
    "round trip, ms", "virtual time", "smallest margin", "kept over a real delay",
    "smallest margin, median (least)", "held up > 20 ms: kept", "round trip p50 / p99, ms",
    "horizon p50 (jitter), ms", "first violation, s",
)  # fmt: skip


def table(found: Sequence[Row]) -> str:
    """The rows as a table in Markdown; runs that were held up are in their own column only."""
    lines = [HEADINGS, ("---",) * len(HEADINGS), *(cells(row) for row in found)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cells(row: Row) -> tuple[str, ...]:
    """A line of the table."""
    steady = [run for run in row.real if not run.was_held_up]
    held_up = [run for run in row.real if run.was_held_up]
    margins = [run.margin_min for run in steady if run.margin_min is not None]
    violations = [run.first_violation_s for run in steady if run.first_violation_s is not None]
    return (
        f"{row.round_trip_ms:g}",
        "kept" if row.virtual.kept else "lost",
        _percent(row.virtual.margin_min),
        f"{sum(run.kept for run in steady)} of {len(steady)}",
        f"{_percent(float(np.median(margins)))} ({_percent(min(margins))})" if margins else "–",
        f"{sum(run.kept for run in held_up)} of {len(held_up)}" if held_up else "none",
        " / ".join(_median([run.round_trip_ms[name] for run in steady]) for name in ("p50", "p99")),
        f"{_median([run.horizon_ms for run in steady])}"
        f" ({_median([run.horizon_jitter_ms for run in steady])})",
        ", ".join(f"{value:.2f}" for value in violations) or "–",
    )


def _median(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.median(known):.2f}" if known else "–"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.1f} %"


def _verdict(run: Outcome) -> str:
    cell = f"{'kept' if run.kept else 'lost'}, smallest margin {_percent(run.margin_min)}"
    if run.was_held_up:
        cell += f", held up for {run.longest_stall_ms:.0f} ms"
    return cell + "".join(f"; {fault}" for fault in run.faults[:1])


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main() -> None:
    """Print the table, and write it with all that is behind it."""
    parser = argparse.ArgumentParser(description="Virtual time beside a real delay.")
    parser.add_argument("scenario")
    parser.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--round-trips", required=True, metavar="MS,MS,…")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    try:
        found = list(
            rows(
                options.scenario, options.overrides, _numbers(options.round_trips),
                _positive(options.repetitions), options.out,
            )
        )  # fmt: skip
    except InputError as error:
        _say(f"error: {error}")
        sys.exit(BAD_INPUT)
    print(table(found), end="")
    results: dict[str, Any] = {**provenance(), "rows": [asdict(row) for row in found]}
    write_json(options.out / "real_delay.json", results)
    write_whole(options.out / "real_delay.md", table(found))


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError as error:
        raise ScenarioError(f"--round-trips {text}: must be numbers of ms: 48,64") from error


def _positive(repetitions: int) -> int:
    if repetitions < 1:
        raise ScenarioError(f"--repetitions {repetitions}: must be 1 or more")
    return repetitions


if __name__ == "__main__":
    main()
