"""The recorder on a slow disk: `funnel-hil record`, each of whose writes takes its time.

`python -m deploy.benchmarks.slow_recorder record SCENARIO --log FILE`
"""

from __future__ import annotations

import time
from pathlib import Path

from bus_schema.recording import mcap_log
from bus_schema.recording.atomic_files import RecordFile
from deploy import cli

_BYTES_PER_S = 2e6
_STALL_S, _STALL_AFTER_BYTES = 0.25, 1 << 20
_SHORTEST_SLEEP_S = 0.01


class SlowFile(RecordFile):
    """A file on a disk of 2 MB/s that stands still for a quarter of a second after every MiB."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._owed_s = 0.0
        self._until_stall = _STALL_AFTER_BYTES

    def write(self, data: bytes) -> int:
        self._owed_s += len(data) / _BYTES_PER_S
        self._until_stall -= len(data)
        if self._until_stall <= 0:
            self._until_stall = _STALL_AFTER_BYTES
            self._owed_s += _STALL_S
        if self._owed_s > _SHORTEST_SLEEP_S:
            time.sleep(self._owed_s)
            self._owed_s = 0.0
        return super().write(data)


if __name__ == "__main__":
    mcap_log.RecordFile = SlowFile  # type: ignore[attr-defined]
    cli.main()
