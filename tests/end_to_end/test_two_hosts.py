"""The tutorial "Two hosts with keys", in two network namespaces."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from running import Finished, funnel_hil_here, outputs_of, settings

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import Role
from deploy.run.network.keys import create_authority, issue
from scripts.experiments.link_between_hosts import measure
from scripts.experiments.two_hosts import ADDRESSES, Host, two_hosts
from tests.warm_process import WarmProcess

PLANT_HOST, CONTROLLER_HOST = ADDRESSES
RUN = ["paper_arm", *settings(clock="lockstep", duration_s=1)]


@pytest.fixture
def hosts() -> Iterator[tuple[Host, Host]]:
    """Hosts of the plant and of the controller."""
    with ExitStack() as stack:
        try:
            made = stack.enter_context(two_hosts())
        except OSError as error:
            pytest.skip(str(error))
        yield made


def hand_out(keys: KeyFolder, folder: Path, *roles: Role) -> Path:
    """What a host gets: the authority's certificate, and the files of the roles it plays."""
    folder.mkdir()
    for file in (keys.authority, *map(keys.certificate, roles), *map(keys.key, roles)):
        shutil.copy(file, folder)
    return folder


def start(host: Host, verb: str, keys: Path, *words: str) -> WarmProcess:
    secured = settings(
        link__security__enabled=True, link__security__folder=str(keys),
        link__plant_endpoint=f"tcp/{PLANT_HOST}:7451",
        link__controller_endpoint=f"tcp/{CONTROLLER_HOST}:7452",
        link__connect_timeout_s=60,
    )  # fmt: skip
    return WarmProcess(
        verb, *RUN, *secured, *words,
        main="tests.end_to_end.at_host:main", environment={**os.environ, "HOST": host.namespace},
    )  # fmt: skip


def test_plant_and_controller_on_two_hosts_under_tls(hosts, tmp_path):
    keys = KeyFolder.at(tmp_path / "authority")
    create_authority(keys, 1)
    issue(keys, Role.PLANT, [PLANT_HOST], 1)
    issue(keys, Role.CONTROLLER, [CONTROLLER_HOST], 1)
    issue(keys, Role.RECORDER, [], 1)
    at_plant = hand_out(keys, tmp_path / "plant_host", Role.PLANT, Role.RECORDER)
    at_controller = hand_out(keys, tmp_path / "controller_host", Role.CONTROLLER)
    out = tmp_path / "run"
    processes = [
        start(hosts[0], "record", at_plant, "--out", str(out)),
        start(hosts[0], "plant", at_plant, "--await-recorder"),
        start(hosts[1], "controller", at_controller, "--await-recorder"),
    ]
    outputs = outputs_of(processes)
    assert [process.returncode for process in processes] == [0, 0, 0], outputs
    run = Finished(out, 0, outputs[0])
    assert run.summary["completed"]
    assert run.summary["recorder"]["lost"] == 0
    simulation = funnel_hil_here("simulate", *RUN, out=tmp_path / "simulation")
    assert run.digest == simulation.digest


def test_injected_delay_and_loss_are_measured_between_two_hosts(hosts: tuple[Host, Host]) -> None:
    for found in measure(hosts, "udp", 5.0, 0.05, 1.0).values():
        assert found.delays_ms.min() >= 5.0
        # A busy machine delays some messages more; the quickest show what the relay does.
        assert np.quantile(found.delays_ms, 0.05) == pytest.approx(5.0, abs=0.5)
        least, most = found.loss_interval
        assert least < 0.075
        assert most > 0.025
        assert found.lost > 0
