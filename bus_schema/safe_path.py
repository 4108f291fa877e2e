"""Python processes that import nothing from the current folder, which may hold files of others."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

_VARIABLE, _OURS = "PYTHONSAFEPATH", "funnel-hil"


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep the current folder off the path of every Python process started in this context.

    For starts by libraries, which pass no options; a command line of ours has ``-P``. Children
    inherit the variable: they call `restore_path` before they start a program of the user's.
    """
    is_ours = _VARIABLE not in os.environ
    os.environ.setdefault(_VARIABLE, _OURS)
    try:
        yield
    finally:
        if is_ours:
            restore_path()


def restore_path() -> None:
    """Let programs of the user's find their modules again, unless the user decided otherwise."""
    if os.environ.get(_VARIABLE) == _OURS:
        del os.environ[_VARIABLE]
