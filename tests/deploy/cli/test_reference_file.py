"""The reference as a file, held against the scenario's own definition."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from deploy.cli.commands import app

SINUSOIDS = (
    "reference={kind: joint_sinusoids, centre_rad: 0.2,"
    " terms: [{amplitude_rad: 0.1, frequency_rad_s: 2}]}"
)


def write(*words: str) -> None:
    arguments = ["reference", "paper_arm", "--set", "duration_s=0.5", "--set", SINUSOIDS, *words]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_file_has_a_row_per_tick_with_all_derivatives(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "reference"
    write(f"--{kind}", "--out", str(path))
    if kind == "csv":
        with path.open() as file:
            rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    else:
        rows = parquet.read_table(path).to_pylist()
    assert len(rows) == 501
    for row in (rows[0], rows[250], rows[-1]):
        angle = 2.0 * row["time_s"]
        assert row["shoulder.position_rad"] == pytest.approx(0.2 + 0.1 * math.sin(angle))
        assert row["shoulder.velocity_rad_s"] == pytest.approx(0.2 * math.cos(angle))
        assert row["elbow.acceleration_rad_s2"] == pytest.approx(-0.4 * math.sin(angle))
    assert [row["time_s"] for row in rows] == pytest.approx([0.001 * k for k in range(501)])
