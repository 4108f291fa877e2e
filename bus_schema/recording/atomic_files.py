"""Files that appear under their name only when they are complete.

Until then they go by another: what was to become ``run.mcap`` is ``run.partial.mcap``.
"""

from __future__ import annotations

import os
from pathlib import Path


def partial_path(path: Path) -> Path:
    """Where a file is written until it is complete: beside its place, for a rename to do."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def complete(path: Path) -> None:
    """Give a file that is written its name, once it is safe on the disk.

    Raises:
        OSError: it cannot be brought to the disk.
    """
    with partial_path(path).open("rb") as file:
        os.fsync(file.fileno())
    partial_path(path).replace(path)


def write_whole(path: Path, text: str) -> None:
    """Write a text file; whatever happens, there is all of it or none.

    Raises:
        OSError: it cannot be written.
    """
    partial = partial_path(path)
    try:
        partial.write_text(text, encoding="utf-8")
        complete(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
