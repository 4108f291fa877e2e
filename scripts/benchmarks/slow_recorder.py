"""The recorder on a slow disk, each of whose writes takes its time.

`python -m scripts.benchmarks.slow_recorder SCENARIO FILE [KEY=VALUE…]`
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from unittest import mock

from bus_schema.recording import mcap_log
from bus_schema.recording.atomic_files import RecordFile
from bus_schema.runtime.realtime import raise_priority
from deploy.run.processes.recorder import Recorder
from deploy.scenario.scenario import load_setup

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


def main() -> None:
    """Record a run in real time; exit code 1 if the recording is not whole."""
    scenario, file, *overrides = sys.argv[1:]
    setup = load_setup(scenario, overrides)
    raise_priority()
    with mock.patch.object(mcap_log, "RecordFile", SlowFile):
        recorder = Recorder(setup, Path(file))
    recorder.run(lambda: False)
    recorder.close()
    sys.exit(recorder.failure is not None)


if __name__ == "__main__":
    main()
