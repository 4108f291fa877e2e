"""The library that draws the figures: packed inside a page, or a file that pages of a study share.

Unpacked it is larger than most reports; every browser since 2023 unpacks it in a few milliseconds.
"""

from __future__ import annotations

import base64
import contextlib
import zlib
from functools import cache
from pathlib import Path

from plotly.offline import get_plotlyjs

from bus_schema.recording.atomic_files import write_whole

FILE = "plotly.min.js"
_FAST = 1  # three times as fast as the usual level, for a sixth more


@cache
def packed() -> str:
    """The library as base64 of what ``DecompressionStream("deflate")`` unpacks."""
    return base64.b64encode(zlib.compress(get_plotlyjs().encode(), _FAST)).decode()


def share(folder: Path) -> None:
    """Put the library beside the reports of a folder; where it cannot be, each has its own."""
    if not _is_in(folder):
        with contextlib.suppress(OSError):
            write_whole(folder / FILE, get_plotlyjs())


def address(report: Path) -> str:
    """Where a report finds a shared library: beside it or one folder up; "" where there is none."""
    if _is_in(report.parent):
        return FILE
    return f"../{FILE}" if _is_in(report.parent.parent) else ""


def _is_in(folder: Path) -> bool:
    """Whether a folder has the library, and of this version."""
    file = folder / FILE
    return file.is_file() and file.read_bytes() == get_plotlyjs().encode()
