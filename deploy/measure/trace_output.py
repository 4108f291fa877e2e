"""Writes traces, and says what is in them and how a scenario uses them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.recording.atomic_files import complete, naming_file, new_partial
from deploy.judge.findings.link_delays import MeasuredDelays
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.trace_file import ONE_WAY, ROUND_TRIP


def write_table(columns: Mapping[str, Any], file: Path, *, is_parquet: bool) -> None:
    """Write columns as Parquet, or as CSV; a file that is there is replaced as a whole.

    Args:
        columns: values by name, all as long.
        file: where to.
        is_parquet: which of the two.
    """
    import pyarrow as pa  # heavy, and needed by few commands
    from pyarrow import csv, parquet

    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    write = parquet.write_table if is_parquet else csv.write_csv
    with naming_file(file):
        write(table, str(new_partial(file)))
    complete(file)


def write_trace(measured: MeasuredDelays, file: Path, *, is_round_trip: bool = False) -> None:
    """Write a trace.

    Args:
        measured: the messages.
        file: where to.
        is_round_trip: the delays are halves of round trips, to be replayed together.

    Raises:
        ScenarioError: there are not two messages, none arrived, or a delay is negative.
    """
    sent_s, delays_ms = measured
    if len(sent_s) < 2 or measured.lost == len(sent_s):
        raise ScenarioError(
            f"{file}: nothing to write: a trace needs at least two messages, one of which arrives"
        )
    least = float(np.nanmin(delays_ms))
    if least < 0.0:
        raise ScenarioError(
            f"{file}: the smallest delay is {least:g} ms, because the clocks differ: give the true"
            " smallest delay with --least MS"
        )
    times_s = np.round(sent_s - sent_s[0], 9)
    name, scale = (ROUND_TRIP, 2.0) if is_round_trip else (ONE_WAY, 1.0)
    delays = [None if np.isnan(each) else round(scale * each, 6) for each in delays_ms.tolist()]
    columns = {"time_s": times_s, name: delays}
    write_table(columns, file, is_parquet=file.suffix == ".parquet")


def scenario_lines(files: Mapping[str, Path]) -> Iterator[str]:
    """The lines of a scenario that replays traces, by direction."""
    yield "link:"
    for direction, file in files.items():
        yield f"  {direction}: {{trace: {{file: {file}}}}}"
