"""The series of a run as files that other programs read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from bus_schema.errors import did_you_mean
from bus_schema.recording.atomic_files import complete, naming_file, new_partial
from deploy.judge.run_data import RunData
from deploy.judge.time_series import SERIES, series
from deploy.scenario.yaml_files import ScenarioError

Format = Literal["csv", "parquet"]


def export_series(
    run: RunData, folder: Path, formats: Sequence[Format], names: Sequence[str] = SERIES
) -> list[Path]:
    """Write series of a run, a file each; existing ones are replaced.

    Args:
        run: the run.
        folder: where; made if it is not there.
        formats: of the files.
        names: which, of `SERIES`.

    Raises:
        ScenarioError: there is no series of a name.
        OSError: a file cannot be written.
    """
    import pyarrow as pa  # heavy
    from pyarrow import csv, parquet

    for name in names:
        if name not in SERIES:
            allowed = f"must be one of {', '.join(SERIES)}{did_you_mean(name, SERIES)}"
            raise ScenarioError(f"--series {name[:100]}: {allowed}")
    folder.mkdir(parents=True, exist_ok=True)
    write = {"csv": csv.write_csv, "parquet": parquet.write_table}
    files = []
    for name in names:
        table = pa.table({column: pa.array(values) for column, values in series(run, name).items()})
        for kind in formats:
            file = folder / f"{name}.{kind}"
            with naming_file(file):
                write[kind](table, str(new_partial(file)))
            complete(file)
            files.append(file)
    return files
