"""The loop closed over a real vcan0. User-mode Linux is slow, and so runs are short.

The same digest on every interface, with frames that a stranger on the bus has seen too.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cantools
import pytest

from bus_schema.can.cia402.master import MASTER_NODE
from bus_schema.can.frame import CanFrame
from bus_schema.can.session import check_can_bus, open_can_bus
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CANSIMPLE_DBC, CIA402_EDS, CanConfiguration
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.eds_decoding import EdsDecoder

ROOT = Path(__file__).resolve().parents[2]
VCAN = CanConfiguration(interface="socketcan", channel="vcan0")
HANG_S = 1500
PATIENT = ["link.can.answer_timeout_s=60", "link.reply_timeout_s=60", "link.connect_timeout_s=600"]
SHORT = ["duration_s=0.1", *PATIENT]
TICKS = 50


@contextmanager
def stranger_listening() -> Iterator[list[CanFrame]]:
    """Somebody else on vcan0; what they received."""
    received: list[CanFrame] = []
    bus, over = open_can_bus(VCAN), threading.Event()

    def listen() -> None:
        while True:
            frame = bus.receive(0.1)
            if frame is not None:
                received.append(frame)
            elif over.is_set():  # and all that was sent before has been read
                return

    thread = threading.Thread(target=listen)
    thread.start()
    try:
        yield received
    finally:
        over.set()
        thread.join()
        bus.close()


def digest_over(interface: str, *overrides: str) -> str:
    setup = load_setup("paper_arm_can", [*SHORT, f"link.can.interface={interface}", *overrides])
    return simulate(setup).data().digest


def test_run_of_three_processes_gives_the_digest_of_the_virtual_bus(tmp_path: Path) -> None:
    sets = [word for value in (*SHORT, "link.can.interface=socketcan") for word in ("--set", value)]
    main = "from tests.warm_process import without_report; without_report()"
    command = [sys.executable, "-c", main, "run", "paper_arm_can", *sets]
    with stranger_listening() as received:
        ended = subprocess.run(
            [*command, "--out", str(tmp_path / "run")], cwd=ROOT, timeout=HANG_S, check=False,
            env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["bounds"]["kept"]
    assert summary["digest"] == digest_over("virtual")
    logged = (tmp_path / "run" / "can.log").read_text().splitlines()
    contents = {f"{frame.identifier:03X}#{frame.data.hex().upper()}" for frame in received}
    assert {line.split()[2] for line in logged} <= contents
    assert sum(frame.identifier == 0x080 for frame in received) >= TICKS  # SYNC
    decoder = EdsDecoder(CIA402_EDS, (1, 2, 3), MASTER_NODE)
    for frame in received:
        decoder.decode(frame.identifier, frame.data)  # raises where the EDS does not explain it


def test_cansimple_frames_on_vcan_decode_with_our_dbc() -> None:
    with stranger_listening() as received:
        digest = digest_over("socketcan", "link.can.protocol=cansimple")
    assert digest == digest_over("virtual", "link.can.protocol=cansimple")
    database = cantools.database.load_file(CANSIMPLE_DBC)
    for frame in received:
        message = database.get_message_by_frame_id(frame.identifier & 0x1F)
        if not frame.is_remote:
            message.decode(frame.data)
    assert len(received) > 3 * 3 * TICKS  # request, estimates and torque of three axes


@pytest.mark.parametrize(
    "overrides",
    [
        ("controller.drive_feedback.enabled=true",),
        ("link.can.protocol=mit", "controller.drive_feedback.enabled=true",
         "link.can.mit.stiffness_nm_rad=200000", "link.can.mit.damping_nm_s=5000"),
    ],
    ids=["position", "mit"],
)  # fmt: skip
def test_drives_that_close_loops_give_the_digest_of_the_virtual_bus(overrides):
    assert digest_over("socketcan", *overrides) == digest_over("virtual", *overrides)


def test_interface_that_is_not_there_is_named() -> None:
    with pytest.raises(ConfigurationError, match=r"link\.can\.channel = 'can7'.*no such CAN"):
        check_can_bus(CanConfiguration(interface="socketcan", channel="can7"))


def test_interface_that_is_down_is_named() -> None:
    subprocess.run(["ip", "link", "add", "dev", "vcan9", "type", "vcan"], check=True)
    try:
        with pytest.raises(ConfigurationError, match=r"vcan9.*is down.*ip link set vcan9 up"):
            check_can_bus(CanConfiguration(interface="socketcan", channel="vcan9"))
    finally:
        subprocess.run(["ip", "link", "del", "vcan9"], check=True)
