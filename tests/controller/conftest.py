"""What tests of the controller share."""

import pytest

from tests.arms import ARMS, shipped_arm


@pytest.fixture(params=ARMS)
def robot(request):
    """The description of every shipped arm in turn."""
    return shipped_arm(request.param)
