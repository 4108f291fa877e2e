"""A file of records that never ends in half of one, however full the disk is."""

from __future__ import annotations

import contextlib
from pathlib import Path


class RecordFile:
    """A file being written, unbuffered: what `write` returned from is with the operating system.

    Args:
        path: the file; an existing one is replaced.

    Attributes:
        size: bytes written.
    """

    def __init__(self, path: Path) -> None:
        self._raw = path.open("wb", buffering=0)
        self.size = 0

    def write(self, data: bytes) -> int:
        """Write all of these bytes, or none.

        Raises:
            OSError: the disk does not take them; what it took is cut off again.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._raw.write(rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._raw.seek(self.size)
                self._raw.truncate()
            raise
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        self._raw.close()
