"""What runs do without where a machine does not grant it, and what to set up so that it does."""

from __future__ import annotations

import getpass
import os
from collections.abc import Iterable, Mapping
from typing import Any

from bus_schema.runtime.realtime import (
    AFFINITY,
    IDLE_STATES,
    MEMORY_LOCK,
    PRECEDENCE,
    SCHEDULER,
)

_REMEDIED = (SCHEDULER, MEMORY_LOCK, IDLE_STATES, PRECEDENCE)
_GROUP = "realtime"


def lacking(settings: Iterable[Mapping[str, Any]]) -> str:
    """One line on settings that were refused; empty where none was.

    Args:
        settings: fields of `RealtimeSetting`, of one process or of several.
    """
    refused = [setting for setting in settings if not setting["granted"]]
    names = dict.fromkeys(setting["name"] for setting in refused)
    if not names:
        return ""
    own = {setting["detail"] for setting in refused if setting["name"] == AFFINITY}
    said = f"works without {', '.join(names)}" + "".join(f" ({detail})" for detail in sorted(own))
    if names.keys() & set(_REMEDIED):
        said += ": more deadlines may be missed; funnel-hil doctor --fix shows how to allow it"
    return said


def remedy() -> str:
    """Commands that allow real-time runs to the user, to be copied; nothing is changed by it."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without an entry in /etc/passwd
        user = str(os.getuid())
    return f"""\
# Allows real-time runs to {user}, once and for all. To be run as root; then log in again.
groupadd --force {_GROUP}
usermod --append --groups {_GROUP} {user}
cat >/etc/security/limits.d/99-{_GROUP}.conf <<'END'
@{_GROUP} - rtprio 50
@{_GROUP} - memlock unlimited
@{_GROUP} - nice -10
END
cat >/etc/udev/rules.d/99-{_GROUP}.rules <<'END'
KERNEL=="cpu_dma_latency", GROUP="{_GROUP}", MODE="0660"
END
udevadm control --reload-rules && udevadm trigger --name-match=cpu_dma_latency"""
