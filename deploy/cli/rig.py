"""The check of `doctor --rig`: queries the drives on a real bus before any command."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing

from bus_schema.can.protocol import PROTOCOLS, DriveProtocol
from bus_schema.can.session import check_can_bus, open_can_bus
from bus_schema.can.survey import FORMAT, ask_drives
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration
from deploy.cli.parts.findings import Finding
from deploy.scenario.link_kinds.can import check_drives
from deploy.scenario.setup import Setup

_TOLERANCE = 1e-3
_SILENT = "check its power, its wiring, its address, and whether it is set to CAN FD"


def examine_rig(setup: Setup) -> list[Finding]:
    """Query every address on a scenario's bus, without enabling a drive or sending a torque."""
    can, robot = setup.scenario.link.can, setup.robot
    protocol = PROTOCOLS[can.protocol]()
    node_ids = check_drives(can, robot, setup.scenario.plant, takes_targets=setup.drive.is_active)
    place = f"{can.interface} {can.resolved_channel}"
    try:
        check_can_bus(can)
        bus = open_can_bus(can)
    except ConfigurationError as error:
        return [Finding("bus", "missing", str(error), "no drive can be queried")]
    findings = [Finding("bus", "ok", f"{place} is up", "no drive can be queried")]
    questions = protocol.questions(can, node_ids[0])
    if not questions:
        what = f"{protocol.title} drives answer nothing but commands"
        return [*findings, Finding("drives", "limited", what, "they were not queried")]
    with closing(bus):
        found = ask_drives(bus, protocol, can, range(1, protocol.largest_node_id + 1))
    expected = [
        {**wanted, FORMAT: float(questions[0].is_fd)}
        for wanted in protocol.expected_answers(can, robot)
    ]
    rows = zip(robot.joint_names, node_ids, expected, strict=True)
    findings += [_drive(name, node, found.get(node), wanted) for name, node, wanted in rows]
    return [*findings, _others(protocol, can, sorted(found.keys() - {*node_ids}))]


def _drive(
    joint: str, node_id: int, found: dict[str, float] | None, wanted: Mapping[str, float]
) -> Finding:
    name = f"{joint}, drive {node_id}"
    if found is None:
        return Finding(name, "missing", "no answer", _SILENT)
    wrong = [
        f"{what} is {found[what]:g}, not {value:g}" if what in found else f"no answer about {what}"
        for what, value in wanted.items()
        if abs(found.get(what, float("inf")) - value) > _TOLERANCE * abs(value)
    ]
    if wrong:
        cost = "values in its frames would be misread: change the drive or the scenario"
        return Finding(name, "missing", "; ".join(wrong), cost)
    answers = ", ".join(f"{what} {value:g}" for what, value in found.items())
    return Finding(name, "ok", answers, "")


def _others(protocol: DriveProtocol, can: CanConfiguration, strange: list[int]) -> Finding:
    if strange:
        cost = "run and drives refuse such a bus"
        return Finding("other drives", "missing", f"addresses {strange} also answer", cost)
    last = protocol.largest_node_id
    return Finding(
        "other drives",
        "ok",
        f"no other address of 1 to {last} answers on {can.resolved_channel}",
        "",
    )
