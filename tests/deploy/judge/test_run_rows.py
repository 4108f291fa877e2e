"""Tables of runs on a disk that damages them."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from deploy.judge.run_rows import failed_row, read_rows, write_rows
from deploy.scenario.yaml_files import ScenarioError

FLIPS = 300


def test_flipped_bit_never_changes_a_row_silently(tmp_path: Path) -> None:
    file, noise = tmp_path / "rows.parquet", random.Random(7)
    rows = [
        failed_row(seed, "") | {"point": f"p{seed}", "completed": True, "error": None,
                                "bounds_kept": seed % 3 == 0, "margin_min": noise.random()}
        for seed in range(12)
    ]  # fmt: skip
    write_rows(rows, file, {"point": "string"}, {"machine": "any"})
    whole, read, reported = file.read_bytes(), read_rows(file), 0
    for _ in range(FLIPS):
        damaged, bit = bytearray(whole), noise.randrange(8 * len(whole))
        damaged[bit // 8] ^= 1 << bit % 8
        file.write_bytes(damaged)
        try:
            assert read_rows(file) == read
        except ScenarioError as error:
            assert str(error).startswith(f"{file}: ")
            reported += 1
    assert reported > FLIPS // 2


def test_table_without_a_checksum_is_refused(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    file = tmp_path / "rows.parquet"
    write_rows([failed_row(1, "no")], file)
    parquet.write_table(parquet.read_table(file).replace_schema_metadata(None), file)
    with pytest.raises(ScenarioError, match="has no checksum: must be a table of this version"):
        read_rows(file)
