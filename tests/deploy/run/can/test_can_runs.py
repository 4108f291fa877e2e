"""Runs over CAN in one process: master and drives, with python-can's virtual bus between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path

import cantools
import numpy as np
import pytest

from bus_schema.arrays import Vector
from bus_schema.can.cia402.codec import rated_torque_nm
from bus_schema.can.cia402.master import MASTER_NODE
from bus_schema.can.frame import CanFrame
from bus_schema.can.master import CanMaster
from bus_schema.can.session import open_can_bus
from bus_schema.link.can_configuration import CANSIMPLE_DBC, CIA402_EDS
from bus_schema.messages.topics import JOINT_COMMANDS, JOINT_STATES, PLANT_TRUTH
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.arm_plant import Mode
from tests.eds_decoding import EdsDecoder
from tests.multicast import own_bus

VIRTUAL = ["link.can.interface=virtual", "link.can.answer_timeout_s=20"]
STRUCK_S = 0.5
TICK_S = 0.002
SLOW_DOWN_S = 0.3
"""Object 0x2000: the longest a CiA 402 drive takes to slow down before it brakes."""


@dataclass(frozen=True)
class CanRun:
    """A finished run and the log of its frames."""

    data: RunData
    can_log: Path

    @cached_property
    def faults(self) -> str:
        return "; ".join(self.data.faults())

    @cached_property
    def speed(self) -> Vector:
        """Largest joint speed at every tick, rad/s."""
        return np.abs(self.data.tables[PLANT_TRUTH.name]["velocity"]).max(axis=1)

    def at_rest_from_s(self) -> float:
        """When the arm came to rest for good."""
        times_s = self.data.times_s(PLANT_TRUTH)
        return float(times_s[np.flatnonzero(self.speed > 0.02)[-1]])

    def frames(self) -> list[tuple[int, str]]:
        """Identifier and content of each logged frame."""
        fields = [line.split()[2].split("#") for line in self.can_log.read_text().splitlines()]
        return [(int(identifier, 16), content) for identifier, content in fields]


def run_over_can(folder: Path, *overrides: str) -> CanRun:
    setup = load_setup("paper_arm_can", [*VIRTUAL, *overrides])
    log = folder / "can.log"
    return CanRun(simulate(setup, can_log=log).data(), log)


@pytest.fixture(scope="module")
def cia402(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    return run_over_can(tmp_path_factory.mktemp("cia402"), "duration_s=1")


@pytest.fixture(scope="module")
def cansimple(tmp_path_factory: pytest.TempPathFactory) -> CanRun:
    folder = tmp_path_factory.mktemp("cansimple")
    return run_over_can(folder, "duration_s=1", "link.can.protocol=cansimple")


@pytest.fixture(scope="module")
def in_process() -> RunData:
    setup = load_setup("paper_arm_can", ["duration_s=1", "link.kind=in_process"])
    return simulate(setup).data()


@pytest.mark.parametrize("protocol", ["cia402", "cansimple"])
def test_bounds_are_kept_and_quantisation_is_all_that_differs(
    protocol: str, in_process: RunData, request: pytest.FixtureRequest
) -> None:
    run: CanRun = request.getfixturevalue(protocol)
    over_can = summarise(run.data)
    assert over_can["completed"]
    assert over_can["bounds"]["kept"]
    errors = run.data.true_errors_rad[250:], in_process.true_errors_rad[250:]
    ours, reference = (np.sqrt((each**2).mean(axis=0)) for each in errors)
    assert (ours <= 1.5 * reference).all()


def test_load_of_three_drives_is_that_of_their_frames(cia402: CanRun) -> None:
    """SYNC of 47 bits, 3 TPDO of 111 and 3 RPDO of 79, heartbeats of 55, plus stuff bits."""
    bus = summarise(cia402.data)["transport"]["can"]
    counts = bus["frames_by_identifier"]
    assert counts["080"] == counts["181"] == counts["203"] == 500
    unstuffed = {"0": 47, "1": 111, "2": 79, "7": 55}
    bits = sum(unstuffed[name[0]] * count for name, count in counts.items())
    assert bits / 1e6 <= bus["load"] <= 1.2 * bits / 1e6
    # the last of three states, at the first tick together with three status words
    assert bus["worst_latency_us"] <= 3 * (135 + 105)


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


def holds_in_one_piece(values: list[float], wanted: Vector) -> bool:
    """Whether `wanted` stands somewhere in `values`; there is more before and after a run."""
    starts = range(len(values) - len(wanted) + 1)
    return any(np.array_equal(values[start : start + len(wanted)], wanted) for start in starts)


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
    ("fault", "reason", "emergency"),
    [
        ("drive:2@500ms", "node 2: short circuit", "082#2023"),
        ("over-temperature:3@500ms", "node 3: over-temperature", "083#1043"),
        ("silent:2@500ms", "no answer from drive 2", None),
    ],
)
def test_all_axes_come_to_rest_when_one_drive_fails(
    fault: str, reason: str, emergency: str | None, tmp_path: Path
) -> None:
    run = run_over_can(
        tmp_path, "duration_s=2", f"link.can.faults.drives=['{fault}']",
        "link.can.answer_timeout_s=2",
    )  # fmt: skip
    assert reason in run.faults
    # of the cycle that brought it, so that no consequence stands before its cause
    told_ns = {event.stamp_ns for event in run.data.events if "DriveError" in event.detail}
    assert told_ns == {round(STRUCK_S * 1e9)}
    assert not summarise(run.data)["completed"]
    assert emergency is None or emergency in run.can_log.read_text()
    # the other drives hear of it at the next tick, then slow down; two ticks to see it
    assert run.at_rest_from_s() <= STRUCK_S + SLOW_DOWN_S + 4 * TICK_S
    truth = run.data.tables[PLANT_TRUTH.name]
    assert truth["mode"][-1] == Mode.STOPPING
    assert not truth["torque"][-1].any()


def test_bus_off_stops_all_axes(tmp_path: Path) -> None:
    run = run_over_can(tmp_path, "duration_s=2", "link.can.faults.bus_off_s=0.5")
    assert "node 1: bus-off (0x8140); node 2: bus-off (0x8140); node 3: bus-off" in run.faults
    assert run.at_rest_from_s() <= STRUCK_S + SLOW_DOWN_S + 4 * TICK_S


def test_axes_stop_when_the_masters_heartbeat_stops(tmp_path: Path) -> None:
    """The master beats every 200 ms, and the drives expect it every 70 ms."""
    run = run_over_can(tmp_path, "duration_s=2", "link.can.heartbeat_ms=200")
    assert "node 1: heartbeat of the master lost (0x8130)" in run.faults
    assert "081#3081" in run.can_log.read_text()
    assert run.at_rest_from_s() <= 0.07 + SLOW_DOWN_S + 4 * TICK_S


def test_hostile_frames_are_counted_and_change_nothing(
    cia402: CanRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    run = run_over_can(tmp_path, "duration_s=1", *place, "link.can.fd=true")
    stranger.close()
    assert run.faults == ""
    assert run.data.digest == cia402.data.digest
    rejected = summarise(run.data)["transport"]["can"]["rejected"]
    assert {"pdo_too_short", "pdo_too_long", "no_classical_frame", "unknown_identifier"} <= set(
        rejected
    )
    assert sum(rejected.values()) > 50


def test_error_frames_lengthen_latencies_and_change_nothing_else(
    cia402: CanRun, tmp_path: Path
) -> None:
    noisy = run_over_can(tmp_path, "duration_s=1", "link.can.faults.frame_error_probability=0.1")
    bus, clean = (summarise(run.data)["transport"]["can"] for run in (noisy, cia402))
    assert noisy.data.digest == cia402.data.digest
    assert 0.05 * bus["frames"] < bus["error_frames"] < 0.15 * bus["frames"]
    assert bus["load"] > clean["load"]
    assert bus["worst_latency_us"] > clean["worst_latency_us"]
