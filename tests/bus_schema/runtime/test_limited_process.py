"""A limited process that gives no answer is an error, however it ended."""

from __future__ import annotations

import subprocess

import pytest

from bus_schema.runtime.limited_process import LimitedProcess, LimitedProcessError


def test_process_that_ends_by_itself_just_before_it_is_killed_has_no_answer(monkeypatch):
    """It took an empty answer for the pictures of an arm, whose shape that does not have."""
    limited = LimitedProcess("this", b"")
    assert limited._process.wait() == 0

    def too_late(process, **_):
        raise subprocess.TimeoutExpired(process.args, 30.0)

    monkeypatch.setattr(subprocess.Popen, "communicate", too_late)
    with pytest.raises(LimitedProcessError, match="no answer within 30 s"):
        limited.answer()
    limited._process.stdout.close()
