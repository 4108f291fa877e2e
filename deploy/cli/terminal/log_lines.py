"""What is logged, as lines on standard error."""

from __future__ import annotations

import logging
import sys


class LogLines(logging.Handler):
    """Writes to standard error as it is at the time.

    A live line on a terminal puts itself in its place, so that nothing is written to its end.
    """

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(f"{self.format(record)}\n")
        sys.stderr.flush()
