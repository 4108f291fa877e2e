"""What tests of the plant share."""

import pytest

from plant_emulator.physics import engines
from tests.arms import INSTALLED


@pytest.fixture(params=INSTALLED)
def engine(request, monkeypatch):
    """Every engine that is installed in turn, for arms whose scenario names none."""
    monkeypatch.setattr(engines, "DEFAULT_ENGINE", request.param)
    return request.param
