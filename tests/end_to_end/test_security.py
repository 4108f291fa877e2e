"""A whole run under TLS, with strangers at the door: they change nothing, and learn nothing."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from impostor import FORGED_END, OWN_ID, Impostor
from running import IN_LOCKSTEP, Finished, assert_as_simulated, settings, started

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.messages.types import stamp_of
from bus_schema.zenoh.access import secure_settings
from bus_schema.zenoh.session import ZenohSession
from tests.security import issued_keys
from tests.waiting import await_true

BESIEGED_S = 1.0
"""Of the run's time, from the first message to the one stranger that may listen."""


@dataclass(frozen=True)
class Besieged:
    """A run that was ended by hand, how far it had come for sure, and what strangers received."""

    run: Finished
    come_s: float
    received: list[list[bytes]]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> KeyFolder:
    return issued_keys(tmp_path_factory.mktemp("keys") / "keys")


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
def besieged(keys: KeyFolder, tmp_path_factory: pytest.TempPathFactory) -> Besieged:
    """A run that strangers shoot commands at."""
    folder = tmp_path_factory.mktemp("besieged")
    secured = settings(link__security__enabled=True, link__security__folder=str(keys.path))
    with started(*IN_LOCKSTEP, *secured, out=folder / "run") as run:
        endpoint = run.plant_endpoint()
        sessions, received, guns = [], [], []
        for protocol, security in strangers(keys, issued_keys(folder / "others")):
            address = endpoint.replace("tls", protocol)
            session = ZenohSession([], [address], low_latency=True, security=security)
            text: list[bytes] = []
            state_key = topics.JOINT_STATES.key_expression(0)
            session.subscribe(state_key, lambda delivery, text=text: text.append(delivery.payload))
            guns.append(session.publisher(topics.JOINT_COMMANDS.key_expression(0)))
            sessions.append(session)
            received.append(text)

        controllers = secure_settings(Role.CONTROLLER, 0, keys)
        del controllers["access_control"]
        impostor = Impostor(endpoint, controllers)
        sessions.append(impostor.session)
        await_true(lambda: bool(impostor.session.connected()), "the plant lets it in")

        def shoot() -> float:
            """How far the run has come, as the third of them received."""
            assert run.process.poll() is None, run.end().output
            impostor.speak_as_plant(impostor.truth, OWN_ID, 1)
            for gun in guns:
                gun.put(b"not even a command", b"")
            stamp_ns = stamp_of(received[2][-1]) if received[2] else None
            return 0.0 if stamp_ns is None else stamp_ns * 1e-9

        await_true(lambda: shoot() > 0.0, "one of them hears something")
        come_s = shoot() + BESIEGED_S
        await_true(lambda: shoot() >= come_s, "the run goes on")
        impostor.speak_as_recorder()
        run.send(signal.SIGINT)
        ended = run.end(130)
        for session in sessions:
            session.close()
    return Besieged(ended, come_s, received)


def test_run_under_tls_is_the_same_run(besieged: Besieged, tmp_path: Path) -> None:
    run = besieged.run
    assert run.summary["faults"] == []
    assert run.summary["recorder"]["lost"] == 0
    names = ("joint_states", "joint_commands", "plant_status", "plant_truth")
    assert_as_simulated(run, besieged.come_s, tmp_path / "simulation", *names)


def test_no_stranger_reaches_the_plant(besieged: Besieged) -> None:
    downlink = besieged.run.summary["transport"]["downlink"]
    assert downlink["rejected"] == {}  # one that gets through is counted as malformed
    ticks = besieged.run.summary["ticks"]
    assert downlink["delivered"] >= ticks - 1  # the last may have been on its way


def test_certificate_of_the_controller_does_not_permit_plant_messages(besieged: Besieged) -> None:
    """What it can do without keys: see test_hostile_bus.py."""
    summary = besieged.run.summary
    # Before the loops are known, a recorder also takes in what comes by itself.
    assert summary["recording"]["rejected"].keys() <= {"wrong_role"}
    assert FORGED_END not in besieged.run.log.payloads["run_events"]
    assert summary["recording"]["damage"] == []
    assert summary["verdict"] == "interrupted"


def test_only_the_recorders_certificate_lets_one_listen(besieged: Besieged) -> None:
    nameless, other_authority, recorder, plaintext = besieged.received
    assert nameless == other_authority == plaintext == []
    assert recorder  # the plant's states: so the others had something to miss


def test_private_keys_appear_in_no_file_of_a_run(keys: KeyFolder, besieged: Besieged) -> None:
    run = besieged.run
    for role in Role:
        secret = keys.key(role).read_bytes().splitlines()[1]
        for file in run.folder.iterdir():
            assert secret not in file.read_bytes(), file
        attached = run.log.attachments.values()
        assert not any(secret in data for data in attached)
        assert secret.decode() not in run.output
