import numpy as np
import pytest

from bus_schema.can.cia402.codec import Cia402Settings
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cia402.drive import Cia402Drive
from plant_emulator.drives.drive import DriveFault, DriveSettings
from plant_emulator.drives.fault_plan import PlannedFault, parse_fault, schedule_faults

NODES = (4, 7)
S = 1_000_000_000


@pytest.mark.parametrize(
    ("text", "planned"),
    [
        ("drive:7@3s", PlannedFault(DriveFault.DRIVE, 1, 3 * S, None)),
        ("silent:4@500ms+2s", PlannedFault(DriveFault.SILENT, 0, S // 2, 5 * S // 2)),
        ("encoder-frozen:4@.5s+1.5ms",
         PlannedFault(DriveFault.ENCODER_FROZEN, 0, S // 2, S // 2 + 1_500_000)),
        ("over-temperature:7@0s", PlannedFault(DriveFault.OVER_TEMPERATURE, 1, 0, None)),
    ],
)  # fmt: skip
def test_faults_in_words(text, planned):
    assert parse_fault(text, NODES) == planned


def test_faults_come_and_go_at_their_times():
    sent = []
    bank = DriveBank(
        Cia402Drive, [DriveSettings(node, 1.0, Cia402Settings(1.0)) for node in NODES], sent.append
    )
    bank.measure(np.zeros(2), np.zeros(2), np.zeros(2))
    faults = [parse_fault("silent:4@1s+1s", NODES), parse_fault("drive:7@1500ms", NODES)]
    schedule = schedule_faults(faults, bank)
    announced = {}
    for now_ns in range(0, 3 * S, S // 4):
        announced[now_ns / S] = []
        schedule.run_due(now_ns, announced[now_ns / S].append)
        sent.clear()
        bank.advance(now_ns)
        assert (0x704 in [frame.identifier for frame in sent]) == (not S <= now_ns < 2 * S)
    assert {at: words for at, words in announced.items() if words} == {
        1.0: ["silent injected at node 4"],
        1.5: ["drive injected at node 7"],
        2.0: ["silent over at node 4"],
    }
    assert bank.faults == ["node 7: short circuit in the power stage (0x2320)"]
