"""The one rule of all studies: what is set takes effect in their runs, or is refused.

A study sets some keys by itself, over whatever was set before; and its runs are simulations, in
which nothing connects and time is virtual.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from bus_schema.configuration import ConfigurationError
from controller.laws import LAWS
from deploy.scenario.scenario import given_values
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import read_yaml

LAW = "controller.law"
SEED = "seed"
UNCERTAINTY = "uncertainty"
_CAN = "can"

_PROCESS = "controller.process"
_OF_A_BUS = ("link.domain", "link.security", "link.router_endpoint", "link.connect_timeout_s")
_IDLE = ("clock", "link.plant_endpoint", "link.controller_endpoint")
"""What changes nothing in a simulation; nor in a run of a process, as what is of a bus does."""
_AS_IT_IS = {("clock", "lockstep")}
"""What says of a simulation what it is."""


def require_effect(given: Mapping[str, Any], own: Mapping[str, str]) -> None:
    """Refuse values that a study sets over, and those that mean nothing to its runs.

    Args:
        given: values by dotted key, as under ``set``, of ``--set`` or of a grid.
        own: keys that the study sets by itself, each with what to use in its place.

    Raises:
        ConfigurationError: one of the values would have no effect.
    """
    idle_keys = _IDLE if given.get(_PROCESS) else (*_IDLE, *_OF_A_BUS)
    for key, value in given.items():
        for leaf, said in _leaves(key, value):
            instead = next((text for taken, text in own.items() if _overlap(leaf, taken)), None)
            if instead is not None:
                raise ConfigurationError(key, value, f"must be given {instead}")
            if any(_overlap(leaf, idle) for idle in idle_keys) and (leaf, said) not in _AS_IT_IS:
                allowed = "must be left out: it changes nothing in a study, which simulates"
                raise ConfigurationError(key, value, allowed)


def require_link_effect(given: Mapping[str, Any], setups: Iterable[Setup]) -> None:
    """Refuse what is set of a link that no run of a study goes over.

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
        for leaf, said in _leaves(key, value):
            if leaf.startswith("link.can."):
                allowed = "must be left out, as link.kind is not can: nothing else reads it"
                raise ConfigurationError(key, value, allowed)
            if (leaf, said) == ("link.kind", "zenoh") and is_simulated and not _changed(runs):
                allowed = "must be left out: a study simulates, and nothing goes over Zenoh"
                raise ConfigurationError(key, value, allowed)


def _changed(setups: Iterable[Setup]) -> bool:
    """Whether a file says CAN, which something else was set in place of."""
    files = {setup.source for setup in setups}
    links = [given_values(read_yaml(file), file, ()).get("link") for file in files]
    return any(isinstance(link, dict) and link.get("kind") == _CAN for link in links)


def laws_beside(own: str) -> list[str]:
    """All shipped laws, and the scenario's own one where it is another."""
    return list(dict.fromkeys([*LAWS, own]))


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """What a value sets, which may be a section with keys in it."""
    if not isinstance(value, dict):
        yield key, value
        return
    for name, inner in value.items():
        yield from _leaves(f"{key}.{name}", inner)


def _overlap(one: str, other: str) -> bool:
    """Whether keys are the same, or one is of a section that the other is in."""
    return one == other or one.startswith(f"{other}.") or other.startswith(f"{one}.")
