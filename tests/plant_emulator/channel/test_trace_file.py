"""Files of traces are understood, or refused with line and column."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from plant_emulator.channel.jitter import read_delays_ms
from plant_emulator.channel.trace_file import LOST_NS, Trace, read_trace

MS = 1_000_000


def test_csv_and_parquet_say_the_same(tmp_path: Path) -> None:
    text, binary = tmp_path / "trace.csv", tmp_path / "trace.parquet"
    text.write_text(
        "# of a network\ntime_s; delay_ms ;lost;size\n5;1.5;0;100\n\n5.01;;1;100\n5.02;2;0;9\n"
    )
    columns = {"time_s": [5.0, 5.01, 5.02], "delay_ms": [1.5, None, 2], "lost": [0, 1, 0]}
    parquet.write_table(pa.table(columns), binary)
    for trace in (read_trace(text), read_trace(binary)):
        assert trace.times_ns.tolist() == [0, 10 * MS, 20 * MS]
        assert trace.delays_ns.tolist() == [1_500_000, LOST_NS, 2 * MS]
        assert (trace.gap_ns, trace.length_ns) == (10 * MS, 30 * MS)
        assert trace.mean_delay_ns == 1_750_000


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "0,1\n1,2\n",
            "the columns are '0, 1': one must be of times .*, as time_s and delay_ms or round",
        ),
        ("when,delay_ms\n0,1\n1,2\n", "line 1, column 1 'when' is unknown"),
        ("time_s,delay_ms,rtt\n0,1,2\n", "line 1, column 3 'rtt' is unknown"),
        ("time_s,delay_ms,time_s\n0,1,2\n", "line 1, column 1 'time_s' occurs twice"),
        ("time_s\n0\n1\n", "one of the columns delay_ms and round_trip_ms must be there"),
        ("time_s,delay_ms\n0,1\n\n2,3\n1,2\n", "line 5, column time_s = 1: must not be earlier"),
        ("time_s,delay_ms\n0,1\n,2\n", "line 3, column time_s = empty: must be a finite number"),
        ("time_s,delay_ms\n0,-1\n1,2\n", "line 2, column delay_ms = -1: must be 0 to 60000 ms"),
        ("time_s,delay_ms\n0,1\n1,6e7\n", "line 3, column delay_ms = 6e7: must be 0 to 60000"),
        ("time_s,delay_ms\n0,1\n1,lost\n", "line 3, column delay_ms = 'lost': is not a number"),
        ("time_s;delay_ms\n0;1\n1;2,5\n", "line 3, column delay_ms = '2,5': is not a number"),
        ("time_s,delay_ms,lost\n0,1,0\n1,2,1\n", "line 3, column lost = 1: must be 1 if delay"),
        ("time_s,delay_ms,lost\n0,1,0\n1,,0\n", "line 3, column lost = 0: must be 1 if delay"),
        ("time_s,delay_ms,lost\n0,1,2\n1,2,0\n", "line 2, column lost = 2: must be 1 if delay"),
        ("time_s,delay_ms\n0,1\n", "at least two rows"),
        ("time_s,delay_ms\n0,\n1,\n", "some messages must arrive"),
        ("", "the columns are '': one must be of times"),
    ],
)
def test_what_is_no_trace_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    file = tmp_path / "trace.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=complaint):
        read_trace(file)


def test_cells_of_parquet_are_named_by_their_row(tmp_path: Path) -> None:
    file = tmp_path / "trace.parquet"
    parquet.write_table(pa.table({"time_s": [0.0, 1.0], "delay_ms": [1.0, -2.0]}), file)
    with pytest.raises(ValueError, match=r"row 2, column delay_ms = -2: must be 0 to"):
        read_trace(file)
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(ValueError, match="cannot be read as Parquet"):
        read_trace(file)


def test_small_parquet_file_of_gigabytes_is_refused_by_its_metadata(tmp_path: Path) -> None:
    file, rows = tmp_path / "trace.parquet", 4_000_000
    table = pa.table({"time_s": pa.repeat(0.0, rows), "delay_ms": pa.repeat(0.0, rows)})
    with parquet.ParquetWriter(file, table.schema, compression="zstd") as writer:
        for _ in range(6):
            writer.write_table(table, row_group_size=rows)
    assert file.stat().st_size < 500_000
    before = pa.total_allocated_bytes()
    with pytest.raises(ValueError, match="has 48,000,000 values, and at most 40,000,000 are read"):
        read_trace(file)
    assert pa.total_allocated_bytes() <= before + 1_000_000


@pytest.mark.parametrize(
    ("delays", "kind"), [(["1", "2"], "string"), ([True, False], "bool"), ([b"1", b"2"], "binary")]
)
def test_texts_and_truth_values_of_parquet_are_no_delays(tmp_path: Path, delays, kind) -> None:
    file = tmp_path / "trace.parquet"
    parquet.write_table(pa.table({"time_s": [0.0, 1.0], "delay_ms": delays}), file)
    complaint = f"column delay_ms holds values of type {kind}: must be numbers"
    with pytest.raises(ValueError, match=complaint):
        read_trace(file)
    with pytest.raises(ValueError, match=complaint):
        read_delays_ms(file)


def test_losses_of_parquet_may_be_truth_values(tmp_path: Path) -> None:
    file = tmp_path / "trace.parquet"
    columns = {"time_s": [0.0, 1.0], "delay_ms": [1.0, None], "lost": [False, True]}
    parquet.write_table(pa.table(columns), file)
    assert read_trace(file).delays_ns.tolist() == [MS, LOST_NS]


def test_changed_file_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "trace.csv"
    file.write_text("time_s,delay_ms\n0,1\n1,1\n")
    assert read_trace(file).mean_delay_ns == MS
    file.write_text("time_s,delay_ms\n0,20\n1,20\n")
    assert read_trace(file).mean_delay_ns == 20 * MS


def test_seam_joins_places_that_are_alike() -> None:
    wave = 5 + 4 * np.sin(np.arange(3000) * 2 * np.pi / 97)  # no whole number of periods
    trace = Trace(np.arange(3000) * MS, np.rint(wave * MS).astype(np.int64))
    first, last = trace.seam
    assert first < 150
    assert last >= 2850
    step = abs(int(trace.delays_ns[first]) - int(trace.delays_ns[last]))
    assert step <= np.abs(np.diff(trace.delays_ns)).max()
