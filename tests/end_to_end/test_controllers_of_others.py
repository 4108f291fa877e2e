"""The clients of the tutorial "Your own controller on the bus", as they stand there.

zenoh-pico is built from sources: from the archive that ``ZENOH_PICO_ARCHIVE`` names.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from running import Finished, funnel_hil_here, outputs_of, settings

from tests.security import issued_keys
from tests.waiting import HANG_S, free_endpoint
from tests.warm_process import WarmProcess

CLIENTS = Path(__file__).resolve().parents[2] / "bus_schema" / "clients"
TICKS = 500
SHORT = settings(
    clock="lockstep", duration_s=TICKS / 1000, link__publish_reference=True,
    link__connect_timeout_s=HANG_S,
)  # fmt: skip


def run_with(command: list[str], folder: Path, plant: str, controller: str) -> Finished:
    """A plant and a recorder with a controller that is started first."""
    at = settings(link__plant_endpoint=plant, link__controller_endpoint=controller)
    client = subprocess.Popen(command)
    processes = [
        WarmProcess("plant", "paper_arm", *SHORT, *at, "--await-recorder"),
        WarmProcess("record", "paper_arm", *SHORT, *at, "--out", str(folder)),
    ]
    try:
        outputs = outputs_of(processes)
        assert [process.returncode for process in processes] == [0, 0], outputs
        assert client.wait(HANG_S) == 0
    finally:
        client.kill()
        client.wait()
    return Finished(folder, 0, outputs[1])


def assert_it_commanded(run: Finished) -> None:
    """A client that does not wait for the recorder may begin before it listens: that is counted."""
    assert run.summary["ticks"] == TICKS
    assert run.summary["faults"] == []
    lost = run.summary["recorder"]["lost"]
    assert lost < TICKS
    commands = run.data.tables["joint_commands"]
    assert len(commands) + lost >= TICKS
    final_rad = abs(run.data.true_errors_rad[-1]).max()  # 0.15 rad at first
    assert final_rad < 0.06
    assert len(run.data.tables["joint_reference"]) >= TICKS


def assert_it_commands_as_a_process(command: list[str], folder: Path, **more: object) -> None:
    process = settings(controller__process=command, **more)
    ended = funnel_hil_here("run", "paper_arm", *SHORT, *process, out=folder / "run")
    assert_it_commanded(ended)


def test_python_client(tmp_path: Path) -> None:
    plant, controller = free_endpoint(), free_endpoint()
    command = [sys.executable, str(CLIENTS / "controller.py"), plant, controller]
    assert_it_commanded(run_with(command, tmp_path / "run", plant, controller))


def test_python_client_as_a_process_under_tls(tmp_path: Path) -> None:
    keys = issued_keys(tmp_path / "keys")
    assert_it_commands_as_a_process(
        [sys.executable, str(CLIENTS / "controller.py")], tmp_path,
        link__security__enabled=True, link__security__folder=str(keys.path),
    )  # fmt: skip


@pytest.fixture(scope="session")
def c_client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    archive = os.environ.get("ZENOH_PICO_ARCHIVE", "")
    if not Path(archive).is_file():
        pytest.skip("zenoh-pico's sources are not at hand: ZENOH_PICO_ARCHIVE names no archive")
    folder = tmp_path_factory.mktemp("pico")
    with tarfile.open(archive) as sources:
        sources.extractall(folder, filter="data")
    (pico,) = folder.iterdir()
    build = pico / "build"
    for command in (
        ["cmake", "-S", pico, "-B", build, "-DCMAKE_BUILD_TYPE=Release",
         "-DBUILD_EXAMPLES=OFF", "-DBUILD_TESTING=OFF", "-DBUILD_SHARED_LIBS=OFF"],
        ["cmake", "--build", build, "-j2"],
        ["cc", "-O2", "-Wall", "-Werror", "-DZENOH_LINUX", f"-I{build}/include",
         f"-I{pico}/include", "-o", folder / "controller", CLIENTS / "controller.c",
         build / "lib" / "libzenohpico.a", "-lpthread"],
    ):  # fmt: skip
        subprocess.run(list(map(str, command)), check=True, capture_output=True)
    return folder / "controller"


def test_c_client(c_client: Path, tmp_path: Path) -> None:
    plant, controller = free_endpoint(), free_endpoint()
    command = [str(c_client), plant]
    assert_it_commanded(run_with(command, tmp_path / "run", plant, controller))


def test_c_client_as_a_process(c_client: Path, tmp_path: Path) -> None:
    assert_it_commands_as_a_process([str(c_client)], tmp_path)
