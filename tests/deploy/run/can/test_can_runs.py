"""Runs over CAN in one process: master and drives, with python-can's virtual bus between them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path

import cantools
import numpy as np
import pytest

from bus_schema.can.cia402.codec import rated_torque_nm
from bus_schema.can.cia402.master import MASTER_NODE
from bus_schema.can.frame import CanFrame
from bus_schema.can.master import CanMaster
from bus_schema.can.session import open_can_bus
from bus_schema.link.can_configuration import CANSIMPLE_DBC, CIA402_EDS
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.deploy.run.can.can_runs import (
    CANSIMPLE,
    FEEDBACK,
    MOTEUS,
    CanRun,
    holds_in_one_piece,
    run_over_can,
)
from tests.eds_decoding import EdsDecoder
from tests.multicast import own_bus

STRUCK_S = 0.5
ON_MOTEUS = f"iiwa_can {MOTEUS}"
COMPENSATED = "controller.delay_compensation.enabled=true"
TICK_S = 0.002
SLOW_DOWN_S = 0.3
"""Object 0x2000: the longest a CiA 402 drive takes to slow down before it brakes."""


@pytest.fixture(scope="module")
def cia402(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    return run_over_can("paper_arm_can", "duration_s=1", folder=tmp_path_factory.mktemp("cia402"))


@pytest.fixture(scope="module")
def cansimple(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    folder = tmp_path_factory.mktemp("cansimple")
    plain = ("duration_s=1", "link.can.protocol=cansimple")
    return run_over_can("paper_arm_can", *plain, folder=folder)


@pytest.mark.parametrize(
    "scenario",
    [
        "paper_arm_can", f"paper_arm_can {CANSIMPLE[0]}",
        "paper_arm_can plant.drive_feedback.enabled=true",  # drives could take targets
        "paper_arm_mit controller.law=fixed_time_neural", ON_MOTEUS, "iiwa_can",
        "openarm link.can.fd=false link.can.fd_process_data=false rate_hz=250",
        f"{ON_MOTEUS} {FEEDBACK} {COMPENSATED}",
        f"{ON_MOTEUS} link.uplink.delay_ms=4 {COMPENSATED}",
    ],
)  # fmt: skip
def test_bounds_are_kept_and_quantisation_alone_changes_errors(scenario: str) -> None:
    words = (*scenario.split(), "duration_s=0.6")
    run = run_over_can(*words)
    assert (run.faults, run.summary["completed"]) == ("", True)
    assert run.summary["bounds"]["kept"]
    if not any(word in scenario for word in ("delay", "feedback", "openarm")):
        plain = run_over_can(*words, "link.kind=in_process")
        errors = run.data.true_errors_rad, plain.data.true_errors_rad
        settled = (each[len(each) * 2 // 3 :] for each in errors)
        ours, reference = (np.sqrt((each**2).mean(axis=0)) for each in settled)
        step_rad = 0.0 if scenario.startswith("paper_arm_can") else 4e-4
        assert (ours <= 1.5 * reference + step_rad).all()


def test_log_decodes_completely_with_our_eds(cia402: CanRun) -> None:
    decoder = EdsDecoder(CIA402_EDS, (1, 2, 3), MASTER_NODE)
    decoded: dict[int, list[dict[str, float]]] = {}
    for identifier, content in cia402.frames():
        values = decoder.decode(identifier, bytes.fromhex(content))
        decoded.setdefault(identifier, []).append(values)
    assert {0x000, 0x080, 0x181, 0x203, 0x581, 0x601, 0x701, 0x77F} <= decoded.keys()
    # What the EDS makes of the frames is what the controller saw and gave, cycle by cycle.
    setup = cia402.data.setup
    states, commands = (cia402.data.tables[topic.name] for topic in (JOINT_STATES, JOINT_COMMANDS))
    counts = [values["Position actual value"] for values in decoded[0x182]]
    seen = states["position"][:, 1] / (2 * np.pi) * setup.scenario.link.can.counts_per_turn
    assert holds_in_one_piece(counts, np.rint(seen))
    rated_nm = rated_torque_nm(setup.scenario.link.can, setup.robot)[1]
    per_mille = [values["Target torque"] for values in decoded[0x202]]
    assert holds_in_one_piece(per_mille, np.rint(commands["effort"][:, 1] / rated_nm * 1000))


def test_log_decodes_completely_with_our_dbc(cansimple: CanRun) -> None:
    database = cantools.database.load_file(CANSIMPLE_DBC)
    decoded = 0
    for identifier, content in cansimple.frames():
        assert identifier >> 5 in (1, 2, 3)
        message = database.get_message_by_frame_id(identifier & 0x1F)
        if content != "R":
            message.decode(bytes.fromhex(content))
            decoded += 1
    assert decoded > 3 * 2 * 500  # estimates and torques of three axes at each of 500 ticks


@pytest.mark.parametrize(
    ("scenario", "fault", "reason", "emergency"),
    [
        (ON_MOTEUS, "drive:2@500ms", "drive 2: error 33", None),
        (ON_MOTEUS, "encoder:2@500ms", "drive 2: error 35", None),
        (ON_MOTEUS, "over-temperature:3@500ms", "drive 3: error 38", None),
        ("paper_arm_can", "drive:2@500ms", "node 2: short circuit", "082#2023"),
        ("paper_arm_can", "over-temperature:3@500ms", "node 3: over-temperature", "083#1043"),
        ("paper_arm_can", "silent:2@500ms", "no answer from drive 2", None),
        ("paper_arm_mit", "drive:2@500ms", "node 2: OVER_CURRENT (error 2)", None),
        ("paper_arm_mit", "over-temperature:3@500ms", "node 3: OVER_TEMPERATURE (error 1)", None),
        ("paper_arm_mit", "silent:2@500ms", "no answer from drive 2", None),
        ("openarm", "drive:2@500ms", "node 2: OVER_CURRENT (error 0xa)", None),
        ("openarm", "over-temperature:3@500ms", "node 3: COIL_HOT (error 0xc)", None),
        ("openarm", "encoder:2@500ms", "node 2: SENSOR_ERROR (error 0x5)", None),
        ("openarm", "silent:2@500ms", "no answer from drive 2", None),
    ],
)
def test_all_axes_come_to_rest_when_one_drive_fails(scenario, fault, reason, emergency, tmp_path):
    struck = (
        "duration_s=1.5",
        f"link.can.faults.drives=['{fault}']",
        "link.can.answer_timeout_s=2",
    )
    run = run_over_can(*scenario.split(), *struck, folder=tmp_path)
    assert reason in run.faults
    # of the cycle that brought it, so that no consequence stands before its cause
    stamps_ns = {event.stamp_ns for event in run.data.events if "DriveError" in event.detail}
    assert stamps_ns == {round(STRUCK_S * 1e9)}
    assert emergency is None or any(each.startswith(emergency) for each in run.logged)
    # the other drives hear of it at the next tick, then slow down; two ticks to see it
    if scenario == "paper_arm_can":
        assert run.at_rest_from_s() <= STRUCK_S + SLOW_DOWN_S + 4 * TICK_S
    run.assert_stopped()


def test_bus_off_stops_all_axes() -> None:
    run = run_over_can("paper_arm_can", "duration_s=2", "link.can.faults.bus_off_s=0.5")
    assert "node 1: bus-off (0x8140); node 2: bus-off (0x8140); node 3: bus-off" in run.faults
    assert run.at_rest_from_s() <= STRUCK_S + SLOW_DOWN_S + 4 * TICK_S


def test_axes_stop_when_the_masters_heartbeat_stops(tmp_path: Path) -> None:
    """The master beats every 200 ms, and the drives expect it every 70 ms."""
    run = run_over_can(
        "paper_arm_can", "duration_s=2", "link.can.heartbeat_ms=200", folder=tmp_path
    )
    assert "node 1: heartbeat of the master lost (0x8130)" in run.faults
    assert any(frame.startswith("081#3081") for frame in run.logged)
    assert run.at_rest_from_s() <= 0.07 + SLOW_DOWN_S + 4 * TICK_S


def test_hostile_frames_are_counted_and_change_nothing(cia402, monkeypatch):
    """A stranger sends what is malformed, oversized, unknown or for other nodes, now and then."""
    place, sample, ticks = own_bus(), CanMaster.sample, count()
    setup = load_setup("paper_arm_can", [*place, "link.can.fd=true"])
    stranger = open_can_bus(setup.scenario.link.can)
    rubbish = [
        CanFrame(0x201, b"\x0f\x00\xff"),  # an RPDO that is too short
        CanFrame(0x202, b"\x0f\x00\xff\x7f\x00"),  # too long
        CanFrame(0x203, b"\x0f\x00\xff\x7f", is_fd=True),
        CanFrame(0x201, b"\x0f\x00\xff\x7f", is_extended=True),
        CanFrame(0x204, b"\x0f\x00\xff\x7f"),  # node 4 is not there
        CanFrame(0x080, b"\x01"),  # a SYNC with a counter
        CanFrame(0x601, b"\x40"),  # an SDO request of one byte
        CanFrame(0x000, b"\x63\x00"),  # an NMT command that there is not
        CanFrame(0x181, is_remote=True),
        CanFrame(0x1FFFFFFF, bytes(64), is_extended=True, is_fd=True),
        CanFrame(0x20000040, bytes(8), is_error=True),
    ]

    def sample_in_rubbish(master: CanMaster, now_ns: int) -> None:
        if next(ticks) % 50 == 0:
            for frame in rubbish:
                stranger.send(frame)
        sample(master, now_ns)

    monkeypatch.setattr(CanMaster, "sample", sample_in_rubbish)
    run = run_over_can("paper_arm_can", "duration_s=1", *place, "link.can.fd=true")
    stranger.close()
    assert run.faults == ""
    assert run.data.digest == cia402.data.digest
    rejected = run.summary["transport"]["can"]["rejected"]
    assert {"pdo_too_short", "pdo_too_long", "no_classical_frame", "unknown_identifier"} <= set(
        rejected
    )
    assert sum(rejected.values()) > 50


def test_emergency_of_a_drive_that_goes_on_is_a_fault_of_the_run(cia402, monkeypatch):
    """It moves nothing, and many of them are reported once: anyone can send the frame."""
    place, sample, ticks = own_bus(), CanMaster.sample, count()
    stranger = open_can_bus(load_setup("paper_arm_can", place).scenario.link.can)
    emergency = CanFrame(0x082, bytes.fromhex("1023020000000000"))

    def sample_with_emergency(master: CanMaster, now_ns: int) -> None:
        if next(ticks) % 100 == 50:
            stranger.send(emergency)
        sample(master, now_ns)

    monkeypatch.setattr(CanMaster, "sample", sample_with_emergency)
    run = run_over_can("paper_arm_can", "duration_s=1", *place)
    stranger.close()
    (fault,) = run.data.faults()
    assert fault.startswith("controller at 0.1")
    assert "s: drive 2 sent emergency 0x2310 (" in fault
    assert run.summary["verdict"] == "faulted"
    assert run.data.digest == cia402.data.digest


def test_error_frames_lengthen_latencies_and_change_nothing_else(cia402: CanRun) -> None:
    errors = "link.can.faults.frame_error_probability=0.1"
    noisy = run_over_can("paper_arm_can", "duration_s=1", errors)
    bus, clean = (run.summary["transport"]["can"] for run in (noisy, cia402))
    assert noisy.data.digest == cia402.data.digest
    assert 0.05 * bus["frames"] < bus["error_frames"] < 0.15 * bus["frames"]
    assert bus["load"] > clean["load"]
    assert bus["worst_latency_us"] > clean["worst_latency_us"]


PROTOCOLS = {"cia402": (), "cansimple": CANSIMPLE}
"""In whose position modes drives close loops of their own."""


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_drives_with_loops_keep_bounds_as_those_that_are_no_can_nodes(protocol: str) -> None:
    """The same laws, gains and targets without CAN between them: what differs is rounding."""
    setup = load_setup("paper_arm_can", [FEEDBACK, "duration_s=0.6", "link.kind=in_process"])
    without = CanRun(simulate(setup).data(), None).summary
    over_can = run_over_can("paper_arm_can", FEEDBACK, "duration_s=0.6", *PROTOCOLS[protocol])
    assert over_can.summary["completed"]
    assert over_can.summary["faults"] == []
    assert over_can.summary["bounds"]["kept"]
    assert over_can.summary["bounds"]["margin_min"] == pytest.approx(
        without["bounds"]["margin_min"], abs=0.01
    )


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_targets_that_stop_coming_end_in_the_drives_own_timeout(protocol: str) -> None:
    bus_off = ("duration_s=2", "link.can.faults.bus_off_s=0.3")
    run = run_over_can("paper_arm_can", FEEDBACK, *bus_off, *PROTOCOLS[protocol])
    assert not run.summary["completed"]
    assert run.speed[-1] < 0.02


def test_simulations_at_the_same_time_do_not_meet() -> None:
    """As the workers of a study are; the shipped scenario is on a group that all machines share."""

    def simulated(_: int) -> tuple[str, list[str]]:
        data = simulate(load_setup("paper_arm_can", ["duration_s=0.1"])).data()
        return data.digest, data.faults()

    with ThreadPoolExecutor(2) as threads:
        first, second = threads.map(simulated, range(2))
    assert first == second == simulated(0)
    assert first[1] == []


def iiwa(folder: Path, *overrides: str) -> CanRun:
    return run_over_can("iiwa_can", "duration_s=0.5", *overrides, folder=folder)


def test_process_data_goes_in_fd_frames_and_changes_nothing_else(tmp_path: Path) -> None:
    fd = iiwa(tmp_path)
    frames = fd.logged
    classical = iiwa(tmp_path, "link.can.fd_process_data=false")
    assert fd.summary["completed"]
    assert fd.summary["bounds"]["kept"]
    assert fd.data.digest == classical.data.digest
    # the master's last command of the start, sent by canopen, is a classical frame
    in_cycle = frames[frames.index("080#") :]
    pdos = [frame for frame in in_cycle if frame[0] in "12"]
    assert len(pdos) >= 250 * 14
    assert all("##1" in frame for frame in pdos)
    assert not any("##" in frame for frame in in_cycle if frame[0] not in "12")
    content = [frame.replace("##1", "#") for frame in in_cycle[:2000]]
    assert content == classical.logged[classical.logged.index("080#") :][:2000]
    loads = [each.summary["transport"]["can"]["load"] for each in (fd, classical)]
    assert 0.3 < loads[0] < 0.45
    assert 0.7 < loads[1] < 0.85


def test_targets_of_drive_feedback_go_in_fd_frames_too(tmp_path: Path) -> None:
    fd = iiwa(tmp_path, FEEDBACK)
    in_cycle = fd.logged[fd.logged.index("080#") :]
    classical = iiwa(tmp_path, FEEDBACK, "link.can.fd_process_data=false", "rate_hz=250")
    assert (fd.faults, classical.faults) == ("", "")
    assert all("##1" in frame for frame in in_cycle if frame[0] in "145")
    assert sum(frame.startswith("40") for frame in in_cycle) >= 250 * 7
