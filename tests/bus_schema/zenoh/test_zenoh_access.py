"""Over real sockets: who may not speak is not heard, and who is none of us hears nothing."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
import zenoh.ext

from bus_schema.link.configuration import LinkConfiguration, SecurityConfiguration
from bus_schema.link.key_files import KeyFolder
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.zenoh.access import (
    access_control,
    bundle_key_expression,
    missed_key_expression,
    progress_key_expression,
    recorded_key_expression,
    secure_settings,
)
from bus_schema.zenoh.link import ZenohPlantLink
from bus_schema.zenoh.node import ZenohNode
from bus_schema.zenoh.ros_graph import node_name, node_token
from bus_schema.zenoh.session import ZenohSession
from deploy.processes.network.free_ports import free_ports
from deploy.processes.network.keys import create_authority, issue
from tests.bus_schema.zenoh.zenoh_pair import await_true

HANG_S = 60.0
MINUTE_DAYS = 1 / 1440
STATE, COMMAND = b"joint state", b"joint command"


def make_keys(folder: Path, days: float = 1.0) -> KeyFolder:
    keys = KeyFolder.at(folder)
    create_authority(keys, 1.0)
    for role in Role:
        issue(keys, role, ["127.0.0.1"], days)
    return keys


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> KeyFolder:
    return make_keys(tmp_path_factory.mktemp("keys") / "keys")


@contextmanager
def secured_plant(keys: KeyFolder) -> Iterator[tuple[LinkConfiguration, ZenohPlantLink]]:
    link = LinkConfiguration(
        security=SecurityConfiguration(enabled=True, folder=str(keys.path)),
        plant_endpoint=f"tcp/127.0.0.1:{free_ports(1)[0]}",
        controller_endpoint=f"tcp/127.0.0.1:{free_ports(1)[0]}",
        reply_timeout_s=HANG_S,
    )
    plant = ZenohPlantLink(link, MonotonicClock(), lockstep=True)
    try:
        yield link, plant
    finally:
        plant.close()


class Stranger:
    """A session that claims to be the controller, with settings of its own and no scruples."""

    def __init__(self, endpoint: str, security: dict[str, Any] | None) -> None:
        self._session = ZenohSession([], [endpoint], low_latency=True, security=security)
        self.heard: list[bytes] = []
        for topic in (topics.JOINT_STATES, topics.PLANT_STATUS, topics.PLANT_TRUTH):
            self._session.subscribe(topic.key_expression(0), lambda d: self.heard.append(d.payload))
        self._commands = self._session.publisher(topics.JOINT_COMMANDS.key_expression(0))
        name = node_name(Role.CONTROLLER)
        self._session.announce(node_token(0, self._session.identifier, name))

    def shoot(self) -> None:
        self._commands.put(COMMAND, b"")

    def close(self) -> None:
        self._session.close()


def tls(keys: KeyFolder, role: Role) -> dict[str, Any]:
    """TLS with a role's certificate, and no access control: nothing holds this peer back."""
    settings = secure_settings(role, 0, keys)
    del settings["access_control"]
    return settings


def no_certificate(keys: KeyFolder, _: Path) -> dict[str, Any]:
    return {"transport/link/tls": {"root_ca_certificate": str(keys.authority)}}


def other_authority(keys: KeyFolder, folder: Path) -> dict[str, Any]:
    """Trusts our authority, and shows a controller's certificate of another one."""
    settings = tls(make_keys(folder / "other"), Role.CONTROLLER)
    settings["transport/link/tls"]["root_ca_certificate"] = str(keys.authority)
    return settings


def expired(keys: KeyFolder, folder: Path) -> dict[str, Any]:
    """A controller's certificate of our authority that was valid until a minute ago."""
    copy = KeyFolder.at(folder)
    for file in keys.path.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    copy.authority_key.chmod(0o600)
    issue(copy, Role.CONTROLLER, ["127.0.0.1"], -MINUTE_DAYS)
    return tls(copy, Role.CONTROLLER)


def plaintext(_: KeyFolder, __: Path) -> None:
    return None


def talk(plant: ZenohPlantLink, stranger: Stranger) -> None:
    """Both sides say something."""
    plant.send_state(STATE, b"status")
    stranger.shoot()
    time.sleep(0.02)


def talk_in_vain(plant: ZenohPlantLink, stranger: Stranger) -> None:
    """Both sides talk for a second and a half, or longer where that is a few words."""
    for _ in range(75):
        talk(plant, stranger)


def talk_until(plant: ZenohPlantLink, stranger: Stranger, enough: Callable[[], bool]) -> None:
    """Both sides talk until something has come of it."""
    await_true(lambda: talk(plant, stranger) or enough())


@pytest.mark.parametrize(
    "make", [no_certificate, other_authority, expired, plaintext], ids=lambda make: make.__name__
)
def test_who_is_none_of_us_neither_commands_nor_hears(
    keys: KeyFolder, tmp_path: Path, make: Callable[[KeyFolder, Path], dict[str, Any] | None]
) -> None:
    with secured_plant(keys) as (link, plant):
        security = make(keys, tmp_path)
        protocol = "tcp" if security is None else "tls"
        stranger = Stranger(link.plant_endpoint.replace("tls", protocol), security)
        talk_in_vain(plant, stranger)
        assert stranger.heard == []
        assert plant.take_commands() == []
        stranger.close()


@pytest.mark.parametrize("role", [Role.RECORDER, Role.PLANT])
def test_other_roles_cannot_command(keys: KeyFolder, role: Role) -> None:
    with secured_plant(keys) as (link, plant):
        stranger = Stranger(link.plant_endpoint, tls(keys, role))
        # It is connected; its commands are what is refused.
        talk_until(plant, stranger, lambda: STATE in stranger.heard)
        talk_in_vain(plant, stranger)
        assert plant.take_commands() == []
        assert not plant.sees(Role.CONTROLLER)  # nor can it pretend to be there
        stranger.close()


def test_the_controllers_certificate_opens_the_door(keys: KeyFolder) -> None:
    with secured_plant(keys) as (link, plant):
        stranger = Stranger(link.plant_endpoint, tls(keys, Role.CONTROLLER))
        talk_until(plant, stranger, lambda: STATE in stranger.heard and plant.await_command(0.01))
        assert plant.take_commands()[0].payload == COMMAND
        assert plant.sees(Role.CONTROLLER)
        stranger.close()


def test_false_plant_is_not_heard(keys: KeyFolder) -> None:
    """Who listens at the plant's endpoint with another's certificate is no plant for that."""
    port = free_ports(1)[0]
    false_plant = ZenohSession(
        [f"tls/127.0.0.1:{port}"], [], low_latency=True, security=tls(keys, Role.CONTROLLER)
    )
    states = false_plant.publisher(topics.JOINT_STATES.key_expression(0))
    link = LinkConfiguration(
        security=SecurityConfiguration(enabled=True, folder=str(keys.path)),
        plant_endpoint=f"tcp/127.0.0.1:{port}",
    )
    recorder = ZenohNode(link, Role.RECORDER, lossless=True)
    mailbox = recorder.listen_to_all(100, lossless=True)
    for _ in range(75):
        states.put(STATE, b"")
        time.sleep(0.02)
    assert mailbox.take() is None
    recorder.close()
    false_plant.close()


def test_recorder_says_nothing_but_how_far_it_has_come_and_that_it_has_everything(
    keys: KeyFolder,
) -> None:
    with secured_plant(keys) as (link, plant):
        recorder = ZenohNode(link, Role.RECORDER, lossless=True)
        recorder.announce()
        plant.await_recorder(HANG_S)
        flow, gid = plant._flow, plant._outbox.gid_of(topics.PLANT_TRUTH)
        assert flow is not None
        assert gid is not None
        flow.send(100, mark=5)  # nobody has more than was sent
        await_true(lambda: recorder.tell_progress(gid, 5) or 5 in flow._recorders.values())
        gid = plant._outbox.gid_of(topics.RUN_EVENTS)
        assert gid is not None
        recorder.acknowledge(gid)
        plant.await_recorded()
        assert plant._acknowledged.is_set()
        recorder.close()


def test_viewer_behind_a_router_gets_what_the_recorder_kept_for_it(
    keys: KeyFolder,
) -> None:
    router = f"tls/127.0.0.1:{free_ports(1)[0]}"
    link = LinkConfiguration(
        security=SecurityConfiguration(enabled=True, folder=str(keys.path)),
        router_endpoint=router,
    )
    heard: dict[str, bytes] = {}
    late = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    key = topics.ROBOT_DESCRIPTION.key_expression(0)
    with session_as(Role.PLANT, keys, mode="router", listen__endpoints=[router]):
        recorder = ZenohNode(link, Role.RECORDER, lossless=True)
        for topic in topics.VIEW_TOPICS:
            recorder.advertise(topic)
        recorder.publish(topics.ROBOT_DESCRIPTION, b"the arm")
        with session_as(Role.RECORDER, keys, mode="client", connect__endpoints=[router]) as viewer:
            ear = zenoh.ext.declare_advanced_subscriber(
                viewer, key, lambda s: heard.update(arm=s.payload.to_bytes()), history=late
            )
            tf = viewer.declare_subscriber(
                topics.TF.key_expression(0), lambda s: heard.update(tf=s.payload.to_bytes())
            )

            def is_seen() -> bool:
                recorder.publish(topics.TF, b"where it is")
                return heard == {"arm": b"the arm", "tf": b"where it is"}

            await_true(is_seen)
            ear.undeclare()
            tf.undeclare()
        recorder.close()


def session_as(role: Role, keys: KeyFolder, **settings: Any) -> zenoh.Session:
    """A session of somebody else's, with a role's certificate and no rules of its own."""
    configuration = zenoh.Config()
    unseen = {"scouting__multicast__enabled": False}
    for name, value in {**tls(keys, role), **unseen, **settings}.items():
        configuration.insert_json5(name.replace("__", "/"), json.dumps(value))
    return zenoh.open(configuration)


def test_rules_follow_the_table_of_topics() -> None:
    rules = access_control(Role.PLANT, 7)["rules"]

    def puts(flow: str) -> set[str]:
        return {
            key
            for rule in rules
            if "put" in rule["messages"] and flow in rule["flows"]
            for key in rule["key_exprs"]
        }

    def keys_of(*senders: Role | None) -> set[str]:
        return {t.key_expression(7) for t in (*topics.TOPICS, topics.CLOCK) if t.sender in senders}

    told = {progress_key_expression(7), missed_key_expression(7)}
    bundles = {role: bundle_key_expression(7, role) for role in (Role.PLANT, Role.CONTROLLER)}
    assert puts("egress") == {*keys_of(Role.PLANT, None), bundles[Role.PLANT]}
    assert puts("ingress") == {
        *keys_of(Role.PLANT, Role.CONTROLLER, None), *told, *bundles.values()
    }  # fmt: skip
    for rule in rules:
        if rule["id"].startswith("plant from recorder"):
            assert "put" not in rule["messages"] or set(rule["key_exprs"]) == told
            speaks = rule["messages"] == ["liveliness_token"]
            assert (recorded_key_expression(7) in rule["key_exprs"]) == (
                speaks or "liveliness" in rule["messages"][0]
            )
