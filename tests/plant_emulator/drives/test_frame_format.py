"""CAN FD on one side and classical frames on the other: messages to the user."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bus_schema.can.damiao.codec import REGISTER_IDENTIFIER, RegisterFrame, Request
from bus_schema.can.frame import CanBus, CanFrame
from bus_schema.can.master import CanMaster, DriveError
from bus_schema.can.protocol import PROTOCOLS
from bus_schema.can.session import open_can_bus
from bus_schema.link.can_configuration import CanConfiguration
from deploy.cli.rig import examine_rig
from deploy.scenario.scenario import load_setup
from tests.multicast import own_place
from tests.plant_emulator.drives.test_damiao_clients import FD, rig_of
from tests.waiting import await_true

CLASSICAL = {"fd": False, "fd_process_data": False}
ASK = RegisterFrame(1, Request.REFRESH).packed()


def never() -> bool:
    return False


@contextmanager
def master_at(place: dict, **given: object) -> Iterator[tuple[CanMaster, CanBus]]:
    """A master of the seven motors, of which only the frame format can be wrong."""
    robot = load_setup("openarm", []).robot
    values = load_setup("openarm", []).scenario.link.can.model_dump(exclude_unset=True)
    can = CanConfiguration.model_validate(values | place | given | {"answer_timeout_s": 0.2})
    protocol, bus = PROTOCOLS["damiao"](), open_can_bus(can)
    try:
        nodes = protocol.node_ids(can, robot.joints)
        yield protocol.master(bus, can, nodes, protocol.codec(can, robot)), bus
    finally:
        bus.close()


@pytest.fixture(params=["virtual", "udp_multicast"])
def place(request: pytest.FixtureRequest) -> dict:
    group, port = own_place()
    return {"interface": request.param, "channel": group, "port": port}


def test_fd_master_and_classical_motors_both_report_the_format(place):
    with rig_of(**place) as rig, master_at(place, **FD) as (master, _):
        with pytest.raises(DriveError, match=r"no answer from drive 1, 2, .* to CAN FD frames"):
            master.enable(0.5, never)
        assert set(rig.bank.rejections.counts) == {"no_classical_frame"}
        description = rig.bank.describe(CanFrame(REGISTER_IDENTIFIER, ASK, is_fd=True))
        assert description == "a CAN FD frame, which these drives do not read"


def test_classical_master_of_fd_motors_reports_their_format(place: dict) -> None:
    with rig_of(**place, **FD), master_at(place, **CLASSICAL) as (master, _):
        with pytest.raises(DriveError, match="to classical frames"):
            master.enable(0.5, never)
        words = "CAN FD frames, and link.can.fd_process_data is false"
        assert words in master.strangers()


def test_dry_run_names_the_frame_format(place: dict) -> None:
    words = [f"link.can.{key}={value}" for key, value in (place | CLASSICAL).items()]
    words.append("rate_hz=250")
    with rig_of(**place, **FD) as rig:
        await_true(lambda: rig.events)
        found = {each.name: each.found for each in examine_rig(load_setup("openarm", words))}
        assert found["joint1, drive 1"] == "CAN FD is 1, not 0"
    with rig_of(**place):
        silent = examine_rig(load_setup("openarm", words[:3]))[1]
        assert (silent.found, "CAN FD" in silent.cost) == ("no answer", True)
