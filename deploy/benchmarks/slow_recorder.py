"""The recorder on a slow disk: `funnel-hil record`, each of whose writes takes its time.

`python -m deploy.benchmarks.slow_recorder record SCENARIO --out DIR`
"""

from __future__ import annotations

import time

from bus_schema import mcap_log
from bus_schema.record_file import RecordFile
from deploy import cli

_SEEK_S = 0.03
_BYTES_PER_S = 4e6


class SlowFile(RecordFile):
    """A file on a disk of 4 MB/s that thinks for 30 ms before each write."""

    def write(self, data: bytes) -> int:
        time.sleep(_SEEK_S + len(data) / _BYTES_PER_S)
        return super().write(data)


if __name__ == "__main__":
    mcap_log.RecordFile = SlowFile  # type: ignore[misc]
    cli.main()
