"""Exit codes of commands and processes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from bus_schema.errors import InputError, Stopped
from bus_schema.foreign_text import in_one_line, say

FINISHED, FAULT, BAD_INPUT, BOUNDS_NOT_KEPT, INTERRUPTED = 0, 1, 2, 3, 130


@contextmanager
def with_exit_codes() -> Iterator[None]:
    """End this process with one message and an exit code at bad input and at stop requests."""
    try:
        yield
    except InputError as error:
        say(f"error: {error}", err=True)
        sys.exit(BAD_INPUT)
    except Stopped:
        print("stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except OSError as error:  # the disk is full or was removed
        say(f"error: {in_one_line(str(error))}", err=True)
        sys.exit(FAULT)
