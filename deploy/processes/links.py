"""What a machine must have for a scenario's link, checked before anything starts."""

from __future__ import annotations

from bus_schema.messages.topics import Role
from deploy.scenario.scenario import Setup
from deploy.scenario.yaml_files import naming


def check_link(setup: Setup, *, one_process: bool) -> None:
    """Check that this machine has what the scenario's link needs, before anything starts.

    Raises:
        ScenarioError: it has not.
    """
    with naming(setup.source):
        setup.link_kind.check_machine(setup.scenario.link, one_process=one_process)


def require_keys(setup: Setup, *roles: Role) -> None:
    """Bad keys are bad input, told before anything starts.

    Raises:
        ScenarioError: as `check_keys`.
    """
    security = setup.scenario.link.security
    if security.enabled:
        from deploy.processes.keys import check_keys  # needs libraries that no other run does

        check_keys(security.keys, roles)
