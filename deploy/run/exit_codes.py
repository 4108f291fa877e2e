"""What commands and processes end with."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from bus_schema.errors import InputError, Stopped

FINISHED, FAULT, BAD_INPUT, BOUNDS_NOT_KEPT, INTERRUPTED = 0, 1, 2, 3, 130


@contextmanager
def with_exit_codes() -> Iterator[None]:
    """End this process with one message, and its code, at bad input and at requests to stop."""
    try:
        yield
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except Stopped:
        print("stopped", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except OSError as error:  # a disk that is full or gone
        print(f"error: {error}", file=sys.stderr)
        sys.exit(FAULT)
