"""The tutorial "Two hosts with keys", in two network namespaces."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from running import Finished, funnel_hil_here, outputs_of, settings

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import Role
from deploy.run.network.keys import create_authority, issue
from tests.warm_process import WarmProcess

PLANT_HOST, CONTROLLER_HOST = "192.0.2.10", "192.0.2.11"
RUN = ["paper_arm", *settings(clock="lockstep", duration_s=1)]


def ip(*words: str) -> None:
    ended = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if ended.returncode:
        pytest.skip(f"network namespaces cannot be made here: {ended.stderr.strip()}")


@pytest.fixture
def hosts() -> Iterator[dict[str, str]]:
    """Two namespaces joined by a cable: names by address."""
    if shutil.which("ip") is None:
        pytest.skip("iproute2 is not installed")
    names = {address: f"funnel-hil-{os.getpid()}-{address.rpartition('.')[2]}"
             for address in (PLANT_HOST, CONTROLLER_HOST)}  # fmt: skip
    try:
        for name in names.values():
            ip("netns", "add", name)
        first, second = names.values()
        ip("-n", first, "link", "add", "eth0", "type", "veth", "peer", "name", "eth0",
           "netns", second)  # fmt: skip
        for address, name in names.items():
            ip("-n", name, "address", "add", f"{address}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield names
    finally:
        for name in names.values():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)


def hand_out(keys: KeyFolder, folder: Path, *roles: Role) -> Path:
    """What a host gets: the authority's certificate, and the files of the roles it plays."""
    folder.mkdir()
    for file in (keys.authority, *map(keys.certificate, roles), *map(keys.key, roles)):
        shutil.copy(file, folder)
    return folder


def start(host: str, verb: str, keys: Path, *words: str) -> WarmProcess:
    secured = settings(
        link__security__enabled=True, link__security__folder=str(keys),
        link__plant_endpoint=f"tcp/{PLANT_HOST}:7451",
        link__controller_endpoint=f"tcp/{CONTROLLER_HOST}:7452",
        link__connect_timeout_s=60,
    )  # fmt: skip
    return WarmProcess(
        verb, *RUN, *secured, *words,
        main="tests.end_to_end.at_host:main", environment={**os.environ, "HOST": host},
    )  # fmt: skip


def test_plant_and_controller_on_two_hosts_under_tls(hosts: dict[str, str], tmp_path: Path) -> None:
    keys = KeyFolder.at(tmp_path / "authority")
    create_authority(keys, 1)
    issue(keys, Role.PLANT, [PLANT_HOST], 1)
    issue(keys, Role.CONTROLLER, [CONTROLLER_HOST], 1)
    issue(keys, Role.RECORDER, [], 1)
    at_plant = hand_out(keys, tmp_path / "plant_host", Role.PLANT, Role.RECORDER)
    at_controller = hand_out(keys, tmp_path / "controller_host", Role.CONTROLLER)
    out = tmp_path / "run"
    processes = [
        start(hosts[PLANT_HOST], "record", at_plant, "--out", str(out)),
        start(hosts[PLANT_HOST], "plant", at_plant, "--await-recorder"),
        start(hosts[CONTROLLER_HOST], "controller", at_controller, "--await-recorder"),
    ]
    outputs = outputs_of(processes)
    assert [process.returncode for process in processes] == [0, 0, 0], outputs
    run = Finished(out, 0, outputs[0])
    assert run.summary["completed"]
    assert run.summary["recorder"]["lost"] == 0
    simulation = funnel_hil_here("simulate", *RUN, out=tmp_path / "simulation")
    assert run.digest == simulation.digest
