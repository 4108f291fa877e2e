"""Check of all studies: a value that is set takes effect in their runs, or is refused.

A study overrides some keys by itself; and its runs are simulations, without connections and in
virtual time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bus_schema.configuration import ConfigurationError
from controller.laws import COMPARED_LAWS, LAWS
from deploy.scenario.scenario import file_values, given_values
from deploy.scenario.setup import Setup
from deploy.scenario.starter import ARM_FILES
from deploy.scenario.yaml_files import leaves

LAW = "controller.law"
SEED = "seed"
UNCERTAINTY = "uncertainty"
DELAYS = ("link.uplink.delay_ms", "link.downlink.delay_ms")
TRACES = ("link.uplink.trace.file", "link.downlink.trace.file")
_CAN = "can"

_PROCESS = "controller.process"
_OF_A_BUS = ("link.domain", "link.security", "link.router_endpoint", "link.connect_timeout_s")
_IDLE = ("clock", "link.plant_endpoint", "link.controller_endpoint")
"""Keys without effect in a simulation; nor in a run of a process, like those of a bus."""
_AS_IT_IS = {("clock", "lockstep")}
"""Values that are always true of a simulation."""


def gains_key(law: str) -> str:
    """Return the key of a law's gains in ``controller.gains``."""
    return law if law in LAWS else "custom"


def require_effect(given: Mapping[str, Any], own: Mapping[str, str]) -> None:
    """Refuse values that a study overrides, and those without effect in its runs.

    Args:
        given: values by dotted key, as under ``set``, of ``--set`` or of a grid.
        own: keys that the study sets by itself, each with the alternative to use.

    Raises:
        ConfigurationError: one of the values would have no effect.
    """
    idle_keys = _IDLE if given.get(_PROCESS) else (*_IDLE, *_OF_A_BUS)
    for key, value in given.items():
        for leaf, value_at_leaf in leaves({key: value}):
            instead = next((text for taken, text in own.items() if _overlap(leaf, taken)), None)
            if instead is not None:
                raise ConfigurationError(key, value, f"must be given {instead}")
            if (
                any(_overlap(leaf, idle) for idle in idle_keys)
                and (leaf, value_at_leaf) not in _AS_IT_IS
            ):
                allowed = "must be left out: it has no effect in a study, which only simulates"
                raise ConfigurationError(key, value, allowed)


def require_link_effect(given: Mapping[str, Any], setups: Iterable[Setup]) -> None:
    """Refuse values for a link that no run of a study uses.

    Args:
        given: values by dotted key.
        setups: scenarios of the runs, with every kind of link among them.

    Raises:
        ConfigurationError: one of the values would have no effect.
    """
    runs = list(setups)
    if any(setup.scenario.link.kind == _CAN for setup in runs):
        return
    is_simulated = all(setup.scenario.controller.process is None for setup in runs)
    for key, value in given.items():
        for leaf, value_at_leaf in leaves({key: value}):
            if leaf.startswith("link.can."):
                allowed = "must be left out: it has an effect only with link.kind: can"
                raise ConfigurationError(key, value, allowed)
            if (
                (leaf, value_at_leaf) == ("link.kind", "zenoh")
                and is_simulated
                and not _changed(runs)
            ):
                allowed = "must be left out: a study only simulates and does not use Zenoh"
                raise ConfigurationError(key, value, allowed)


def _changed(setups: Iterable[Setup]) -> bool:
    """Whether a file names CAN, and another link was set instead."""
    files = {each.source for each in setups if each.source.suffix.lower() not in ARM_FILES}
    links = [given_values(file_values(file), file, ()).get("link") for file in files]
    return any(isinstance(link, dict) and link.get("kind") == _CAN for link in links)


def laws_beside(own: str) -> list[str]:
    """Return the laws that are compared by default, and the scenario's own one if it is another."""
    return list(dict.fromkeys([*COMPARED_LAWS, own]))


def _overlap(one: str, other: str) -> bool:
    """Whether keys are equal, or one is a section that contains the other."""
    return one == other or one.startswith(f"{other}.") or other.startswith(f"{one}.")
