"""Which scenario others announce that they run, and who they are."""

from __future__ import annotations

from contextlib import closing

import pytest

from bus_schema.errors import ScenarioMismatchError
from bus_schema.link.agreement import Agreement
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import VirtualClock
from bus_schema.zenoh.access import scenario_key_expression
from bus_schema.zenoh.link import ZenohPlantLink
from bus_schema.zenoh.ros_graph import node_token
from tests.bus_schema.zenoh.zenoh_pair import fresh_link


def test_scenario_token_alone_ends_nobody() -> None:
    """It counts from sessions that announce more, and not where another of that role agrees."""
    ours, theirs = Agreement({"rate_hz": "1000"}), Agreement({"rate_hz": "500"})

    def token(session: str, agreement: Agreement) -> str:
        return scenario_key_expression(0, Role.CONTROLLER, session, agreement.encode())

    with closing(
        ZenohPlantLink(fresh_link(), VirtualClock(), lockstep=True, agreement=ours)
    ) as plant:
        plant._on_scenario(token("stranger", theirs), True)
        plant.require_same_scenario(Role.CONTROLLER)
        plant._on_token(node_token(0, "stranger", "controller"), True)
        with pytest.raises(ScenarioMismatchError, match="rate_hz"):
            plant.require_same_scenario(Role.CONTROLLER)
        plant._on_scenario(token("ours", ours), True)
        plant.require_same_scenario(Role.CONTROLLER)
