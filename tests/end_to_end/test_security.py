"""A whole run under TLS, with strangers at the door: they change nothing, and learn nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from running import Finished, await_true, funnel_hil_here, settings, started

from bus_schema.link.key_files import KeyFolder
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.zenoh.access import secure_settings
from bus_schema.zenoh.session import ZenohSession
from deploy.processes.network.keys import create_authority, issue

DURATION_S = 20.0  # so that strangers are there long before its end
WORDS = ["paper_arm", *settings(clock="lockstep", duration_s=DURATION_S)]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> KeyFolder:
    return make_keys(tmp_path_factory.mktemp("keys") / "keys")


def make_keys(folder: Path) -> KeyFolder:
    keys = KeyFolder.at(folder)
    create_authority(keys, 1)
    for role in Role:
        issue(keys, role, ["127.0.0.1"], 1)
    return keys


def strangers(keys: KeyFolder, others: KeyFolder) -> list[tuple[str, dict[str, Any] | None]]:
    """By protocol: no certificate, another authority's, the recorder's, none at all."""

    def tls(role: Role, owner: KeyFolder) -> dict[str, Any]:
        settings = secure_settings(role, 0, owner)
        del settings["access_control"]
        settings["transport/link/tls"]["root_ca_certificate"] = str(keys.authority)
        return settings

    nameless = {"transport/link/tls": {"root_ca_certificate": str(keys.authority)}}
    return [("tls", nameless), ("tls", tls(Role.CONTROLLER, others)),
            ("tls", tls(Role.RECORDER, keys)), ("tcp", None)]  # fmt: skip


@pytest.fixture(scope="module")
def besieged(
    keys: KeyFolder, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Finished, list[list[bytes]]]:
    """A run that strangers shoot commands at, and what each of them heard."""
    folder = tmp_path_factory.mktemp("besieged")
    secured = settings(link__security__enabled=True, link__security__folder=str(keys.path))
    with started("run", *WORDS, *secured, out=folder / "run") as run:
        endpoint = run.plant_endpoint()
        sessions, heard, guns = [], [], []
        for protocol, security in strangers(keys, make_keys(folder / "others")):
            address = endpoint.replace("tls", protocol)
            session = ZenohSession([], [address], low_latency=True, security=security)
            said: list[bytes] = []
            state_key = topics.JOINT_STATES.key_expression(0)
            session.subscribe(state_key, lambda delivery, said=said: said.append(delivery.payload))
            guns.append(session.publisher(topics.JOINT_COMMANDS.key_expression(0)))
            sessions.append(session)
            heard.append(said)

        def shoot() -> bool:
            for gun in guns:
                gun.put(b"not even a command", b"")
            return run.process.poll() is not None

        await_true(shoot, "the run ends")
        ended = run.end()
        for session in sessions:
            session.close()
    return ended, heard


def test_run_under_tls_is_the_same_run(
    besieged: tuple[Finished, list[list[bytes]]], tmp_path: Path
) -> None:
    run, _ = besieged
    assert run.code == 0, run.output
    assert run.summary["completed"]
    assert run.summary["recorder"]["lost"] == 0
    simulation = funnel_hil_here("simulate", *WORDS, out=tmp_path / "simulation")
    assert run.digest == simulation.digest


def test_no_stranger_reaches_the_plant(besieged: tuple[Finished, list[list[bytes]]]) -> None:
    downlink = besieged[0].summary["transport"]["downlink"]
    assert downlink["rejected"] == {}  # one that gets through is counted as malformed
    assert downlink["delivered"] == besieged[0].summary["ticks"]


def test_only_the_recorders_certificate_lets_one_listen(
    besieged: tuple[Finished, list[list[bytes]]],
) -> None:
    nameless, other_authority, recorder, plaintext = besieged[1]
    assert nameless == other_authority == plaintext == []
    assert recorder  # the plant's states: so the others had something to miss


def test_private_keys_appear_in_no_file_of_a_run(
    keys: KeyFolder, besieged: tuple[Finished, list[list[bytes]]]
) -> None:
    run = besieged[0]
    for role in Role:
        secret = keys.key(role).read_bytes().splitlines()[1]
        for file in run.folder.iterdir():
            assert secret not in file.read_bytes(), file
        attached = run.log.attachments.values()
        assert not any(secret in data for data in attached)
        assert secret.decode() not in run.output
