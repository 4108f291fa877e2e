"""Tests on a real vcan0: left out where there is none, unless FUNNEL_HIL_NEEDS_VCAN is set."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

HAS_VCAN = Path("/sys/class/net/vcan0").exists()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.socketcan)
            if not HAS_VCAN and not os.environ.get("FUNNEL_HIL_NEEDS_VCAN"):
                item.add_marker(pytest.mark.skip(reason="no vcan0: use scripts/with-vcan"))
