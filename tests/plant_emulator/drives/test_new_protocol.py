"""A drive protocol from outside: an entry in the table of each side, and a loop closes over it.

A cycle is one frame that samples all drives, the answer of each, and a torque to each.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from bus_schema.arrays import Matrix, Vector
from bus_schema.can.frame import CanFrame
from bus_schema.can.frame_timing import CycleFrames
from bus_schema.can.master import CanMaster
from bus_schema.can.protocol import PROTOCOLS, DriveProtocol
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.drives.commissioning import DRIVES
from plant_emulator.drives.drive import (
    AT_REST,
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    Send,
)

SAMPLE, STATE, TORQUE, REST = 0x010, 0x100, 0x200, 0x300
OVER_TOY = ["link.can.interface=virtual", "link.can.protocol=toy", "duration_s=0.2"]


class ToyCodec:
    cycle = CycleFrames((0,), (8, 4), "sample + {n} × (state 8 bytes + torque 4 bytes)")

    def __init__(self, node_ids: Sequence[int]) -> None:
        self._node_ids = node_ids

    def sampling_frames(self) -> Sequence[CanFrame]:
        return [CanFrame(SAMPLE)]

    def is_sampling(self, frame: CanFrame) -> bool:
        return frame.identifier == SAMPLE

    def read_state(self, frame: CanFrame, position: Vector, velocity: Vector) -> int | None:
        joint = self._joint(frame, STATE)
        if joint is not None:
            position[joint], velocity[joint] = struct.unpack("<ff", frame.data)
        return joint

    def command_frames(self, torque_nm: Vector, target: Matrix | None = None) -> Sequence[CanFrame]:
        return [
            CanFrame(TORQUE + node, struct.pack("<f", torque))
            for node, torque in zip(self._node_ids, torque_nm, strict=True)
        ]

    def read_torque(self, frame: CanFrame, torque_nm: Vector) -> int | None:
        joint = self._joint(frame, TORQUE)
        if joint is not None:
            (torque_nm[joint],) = struct.unpack("<f", frame.data)
        return joint

    def _joint(self, frame: CanFrame, function: int) -> int | None:
        node = frame.identifier - function
        return self._node_ids.index(node) if node in self._node_ids else None


class ToyMaster(CanMaster):
    """Drives follow the first torque they get, and rest on request."""

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        self._is_powered = [True] * len(self._node_ids)
        return True

    def command(self, torque_nm: Vector) -> None:
        if self._is_stopping:
            self._send([CanFrame(REST)])
            self._is_powered = [False] * len(self._node_ids)
        else:
            super().command(torque_nm)

    def leave(self) -> None:
        self._send([CanFrame(REST)])


class ToyDrive(Drive):
    targets = samplings = 0

    def __init__(self, settings: DriveSettings, send: Send) -> None:
        super().__init__(settings, send)
        self._node_id = settings.node_id
        self.identifiers = (SAMPLE, TORQUE + self._node_id, REST)
        self._torque_nm: float | None = None

    @property
    def status(self) -> str:
        return "at rest" if self._torque_nm is None else "following"

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if frame.identifier == SAMPLE:
            self.samplings += 1
            data = struct.pack("<ff", self._reading.position_rad, self._reading.velocity_rad_s)
            self._send(CanFrame(STATE + self._node_id, data))
        elif frame.identifier == TORQUE + self._node_id:
            (self._torque_nm,) = struct.unpack("<f", frame.data)
            self.targets += 1
        elif frame.identifier == REST:
            self._torque_nm = None
        else:
            return False
        return True

    def demand(self) -> JointDemand:
        return AT_REST if self._torque_nm is None else JointDemand(self._torque_nm, True)

    def advance(self, now_ns: int) -> None: ...

    def _fail(self, fault: DriveFault, now_ns: int) -> None: ...


class ToyProtocol(DriveProtocol):
    title = "Toy"
    largest_node_id = 9
    master = ToyMaster

    def codec(self, can, robot, gains=None):
        return ToyCodec(self.node_ids(can, robot.joints))


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PROTOCOLS.shipped, "toy", f"{__name__}:ToyProtocol")
    monkeypatch.setitem(DRIVES.shipped, "toy", f"{__name__}:ToyDrive")


def test_loop_closes_over_it() -> None:
    run = simulate(load_setup("paper_arm_can", OVER_TOY)).data()
    summary = summarise(run)
    assert run.faults() == []
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    frames = summary["transport"]["can"]["frames_by_identifier"]
    assert frames["010"] == frames["101"] == frames["203"] == 100
    in_process = simulate(load_setup("paper_arm_can", [*OVER_TOY, "link.kind=in_process"])).data()
    np.testing.assert_allclose(run.true_errors_rad, in_process.true_errors_rad, atol=1e-5)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("link.can.node_ids=[1, 2, 10]", r"node_ids = \[1, 2, 10\]: must be at most 9 with Toy"),
        ("rate_hz=2000", r"takes sample \+ 3 × \(state 8 bytes \+ torque 4 bytes\) = up to"),
        (
            "link.can.protocol=semaphore",
            r"'semaphore': must be 'cia402', 'cansimple', 'mit', 'damiao', 'moteus' or 'toy'",
        ),
    ],
)
def test_scenario_that_does_not_fit_it_is_refused(override: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        load_setup("paper_arm_can", [*OVER_TOY, override])
