"""Drives on a bus are found by what moves none of them; and a bus with others is not commanded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from bus_schema.can.cia402.master import MASTER_NODE
from bus_schema.can.frame import CanBus
from bus_schema.can.master import DriveError
from bus_schema.can.protocol import PROTOCOLS
from bus_schema.can.session import open_can_bus
from bus_schema.can.survey import ask_drives, require_no_others
from bus_schema.link.can_configuration import CIA402_EDS, CanConfiguration
from deploy.cli.parts.findings import Finding
from deploy.cli.rig import examine_rig
from deploy.scenario.scenario import load_setup
from plant_emulator.drives.drive import DriveFault
from tests.eds_decoding import EdsDecoder
from tests.plant_emulator.drives.test_clients import Rig
from tests.plant_emulator.drives.test_damiao_clients import FD, rig_of
from tests.waiting import await_true

ASKED = {
    "cia402": {"rated torque in mN m (0x6076)", "encoder increments per turn (0x608F)", "CAN FD"},
    "cansimple": {"heartbeat", "CAN FD"},
    "damiao": {"PMAX", "VMAX", "TMAX", "CAN FD"},
}


@contextmanager
def rig_and_bus(protocol: str) -> Iterator[tuple[Rig, CanBus]]:
    with Rig(protocol, node_ids=(3, 5, 9)) as rig:
        place = CanConfiguration(interface="virtual", channel=rig.channel)
        await_true(lambda: rig.events)  # they have booted
        with closing(open_can_bus(place)) as bus:
            yield rig, bus


@pytest.mark.parametrize("name", ASKED)
def test_drives_are_found_and_none_moves(name: str) -> None:
    protocol, can = PROTOCOLS[name](), CanConfiguration(protocol=name)
    with rig_and_bus(name) as (rig, bus):
        before = rig.bank.statuses
        found = ask_drives(bus, protocol, can, range(1, 11))
        assert {node: set(answers) for node, answers in found.items()} == dict.fromkeys(
            (3, 5, 9), ASKED[name]
        )
        assert rig.bank.statuses == before
        assert rig.bank.braked.all()


@pytest.mark.parametrize("name", ASKED)
def test_bus_with_drives_that_the_scenario_does_not_know_is_refused(name: str) -> None:
    protocol, can = PROTOCOLS[name](), CanConfiguration(protocol=name)
    with rig_and_bus(name) as (_, bus):
        require_no_others(bus, protocol, can, (3, 5, 9))
        with pytest.raises(DriveError, match="drives with addresses 3, 9 answer on this bus"):
            require_no_others(bus, protocol, can, (5,))


def test_eds_explains_what_absent_nodes_are_asked() -> None:
    decoder = EdsDecoder(CIA402_EDS, (1, 2, 3), MASTER_NODE)
    questions = PROTOCOLS["cia402"]().questions(CanConfiguration(), 4)
    names = [name for each in questions for name in decoder.decode(each.identifier, each.data)]
    assert names == ["Motor rated torque", "Encoder increments"]
    with pytest.raises(ValueError, match="knows no frame 584#"):  # no such node is there to answer
        decoder.decode(0x584, questions[0].data)


def findings(channel: str, *overrides: str) -> dict[str, Finding]:
    place = ("link.can.interface=virtual", f"link.can.channel={channel}")
    found = examine_rig(load_setup("openarm", [*place, *overrides]))
    return {each.name: each for each in found}


def test_dry_run_reads_back_ranges_and_names_what_is_missing_or_wrong() -> None:
    with rig_of(**FD) as rig:
        as_it_is = findings(rig.channel)
        assert {each.status for each in as_it_is.values()} == {"ok"}
        assert as_it_is["joint3, drive 3"].found == "PMAX 12.5, CAN FD 1, VMAX 8, TMAX 28"
        rig.bank.inject(6, DriveFault.SILENT, 0)
        kinds = "[DM8009, DM8009, DM4340_48V, DM4340, DM4310, DM4310, DM4310]"
        wrong = findings(rig.channel, f"link.can.damiao.motor={kinds}")
        assert wrong["joint3, drive 3"].found == "VMAX is 8, not 10"
        assert wrong["joint7, drive 7"].found == "no answer"
        others = findings(rig.channel, "link.can.node_ids=[1, 2, 3, 4, 5, 7, 8]")["other drives"]
        assert (others.status, others.found) == ("missing", "addresses [6] also answer")
        assert all("DISABLED" in each for each in rig.bank.statuses)


def test_dry_run_on_a_bus_that_is_not_there() -> None:
    (bus,) = examine_rig(load_setup("openarm", ["link.can.interface=nope"]))
    assert bus.status == "missing"


def test_mit_drives_are_not_asked() -> None:
    place = ["link.can.interface=virtual", "link.can.channel=unused"]
    _, drives = examine_rig(load_setup("paper_arm_mit", place))
    assert drives.found == "MIT drives answer nothing but commands"
