"""What commands and processes end with."""

from __future__ import annotations

FINISHED, FAULT, BAD_INPUT, BOUNDS_NOT_KEPT, INTERRUPTED = 0, 1, 2, 3, 130
