"""What tests of the plant share."""

from contextlib import ExitStack

import pytest

from plant_emulator.physics import engines
from tests.arms import INSTALLED


@pytest.fixture(params=INSTALLED)
def engine(request, monkeypatch):
    """Every engine that is installed in turn, for arms whose scenario names none."""
    monkeypatch.setattr(engines, "DEFAULT_ENGINE", request.param)
    return request.param


@pytest.fixture
def made_and_freed():
    """Turns a class of benches with an `arm` into a function whose arms are freed at the end."""
    with ExitStack() as arms:

        def of(kind):
            def make(**options):
                bench = kind(**options)
                arms.callback(bench.arm.close)
                return bench

            return make

        yield of
