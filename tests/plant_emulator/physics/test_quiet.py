"""Standard output is restored, also with several silent calls at a time."""

from __future__ import annotations

import os
import threading

import pytest

from tests.arms import needs_bullet


@pytest.fixture
def _streams_put_back():
    kept = [os.dup(1), os.dup(2)]
    yield
    for number, copy in enumerate(kept, start=1):
        os.dup2(copy, number)
        os.close(copy)


def where(descriptor):
    status = os.fstat(descriptor)
    return status.st_dev, status.st_ino


@needs_bullet
@pytest.mark.usefixtures("_streams_put_back")
def test_of_two_threads_none_leaves_standard_output_quiet():
    from plant_emulator.physics.bullet.library import quiet

    before = where(1), where(2)
    other_is_in, first_is_out = threading.Event(), threading.Event()

    def be_quiet_too():
        with quiet():
            other_is_in.set()
            first_is_out.wait(60.0)

    other = threading.Thread(target=be_quiet_too)
    with quiet():
        with quiet():  # one thread may do so twice
            assert before[0] != where(1) == where(2)
        other.start()
        other_is_in.wait(0.5)  # in vain, where only one is let in
    first_is_out.set()
    other.join()
    assert (where(1), where(2)) == before
