"""Over real sockets: who may not speak is not received, and who is none of us hears nothing."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
import zenoh
import zenoh.ext

from bus_schema.link.configuration import KeyFolder, LinkConfiguration
from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.zenoh.access import (
    access_control,
    bundle_key_expression,
    missed_key_expression,
    progress_key_expression,
    recorded_key_expression,
    secure_settings,
)
from bus_schema.zenoh.node import ZenohNode
from bus_schema.zenoh.session import ZenohSession
from deploy.run.network.keys import issue
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, foreign_session, fresh_link, plant_on
from tests.security import issued_keys
from tests.waiting import await_true, free_endpoint

MINUTE_DAYS = 1 / 1440


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> KeyFolder:
    return issued_keys(tmp_path_factory.mktemp("keys") / "keys")


def secured_link(keys: KeyFolder, **values: Any) -> LinkConfiguration:
    security = {"enabled": True, "folder": str(keys.path)}
    return LinkConfiguration(**{**vars(fresh_link()), "security": security, **values})


def tls(keys: KeyFolder, role: Role) -> dict[str, Any]:
    """TLS with a role's certificate, and no access control: nothing holds this peer back."""
    settings = secure_settings(role, 0, keys)
    del settings["access_control"]
    return settings


def expired(keys: KeyFolder, folder: Path) -> dict[str, Any]:
    """A controller's certificate of our authority that was valid until a minute ago."""
    copy = KeyFolder.at(folder)
    for file in keys.path.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    copy.authority_key.chmod(0o600)
    issue(copy, Role.CONTROLLER, ["127.0.0.1"], -MINUTE_DAYS)
    return tls(copy, Role.CONTROLLER)


@pytest.mark.parametrize("is_valid", [True, False], ids=["valid", "expired"])
def test_certificate_counts_until_it_expires(keys, tmp_path, is_valid):
    """Strangers without any, of another role or authority: see end_to_end/test_security.py."""
    link = secured_link(keys)
    with plant_on(link) as plant:
        security = tls(keys, Role.CONTROLLER) if is_valid else expired(keys, tmp_path)
        controller = ZenohSession([], [link.plant_endpoint], low_latency=True, security=security)
        received: list[object] = []
        taken: list[object] = []
        controller.subscribe(topics.JOINT_STATES.key_expression(0), received.append)
        commands = controller.publisher(topics.JOINT_COMMANDS.key_expression(0))

        def talk() -> bool:
            plant.send_state(b"joint state", b"status")
            commands.put(b"joint command", b"")
            time.sleep(0.02)
            taken.extend(plant.take_commands())
            return bool(received and taken)

        if is_valid:
            await_true(talk)
        else:
            for _ in range(75):
                talk()
            assert received == taken == []
        controller.close()


def test_false_plant_is_ignored(keys: KeyFolder) -> None:
    """Who listens at the plant's endpoint with another's certificate is no plant for that."""
    link = secured_link(keys)
    listens = [link.plant_endpoint.replace("tcp", "tls")]
    security = tls(keys, Role.CONTROLLER)
    false_plant = ZenohSession(listens, [], low_latency=True, security=security)
    states = false_plant.publisher(topics.JOINT_STATES.key_expression(0))
    recorder = ZenohNode(link, Role.RECORDER, lossless=True)
    mailbox = recorder.listen_to_all(1 << 20, lossless=True)
    for _ in range(75):
        states.put(b"joint state", b"")
        time.sleep(0.02)
    assert mailbox.take() is None
    recorder.close()
    false_plant.close()


def test_recorder_says_nothing_but_how_far_it_has_come_and_that_it_has_everything(keys):
    link = secured_link(keys, reply_timeout_s=HANG_S)
    with plant_on(link) as plant:
        recorder = ZenohNode(link, Role.RECORDER, lossless=True)
        recorder.announce()
        plant.await_recorder(HANG_S)
        flow, gid = plant._flow, plant.outbox.gid_of(topics.PLANT_TRUTH)
        assert flow is not None
        assert gid is not None
        flow.send(100, mark=5)  # no recorder has more than was sent
        await_true(lambda: recorder.tell_progress(gid, 5) or 5 in flow.recorders.values())
        gid = plant.outbox.gid_of(topics.RUN_EVENTS)
        assert gid is not None
        recorder.acknowledge(gid)
        plant.await_recorded()
        assert plant._acknowledged.is_set()
        recorder.close()


def test_viewer_behind_a_router_gets_what_the_recorder_kept_for_it(keys):
    router = free_endpoint().replace("tcp", "tls")
    link = secured_link(keys, router_endpoint=router)
    received: dict[str, bytes] = {}
    late = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    key = topics.ROBOT_DESCRIPTION.key_expression(0)
    with session_as(Role.PLANT, keys, mode="router", listen__endpoints=[router]):
        recorder = ZenohNode(link, Role.RECORDER, lossless=True)
        for topic in topics.VIEW_TOPICS:
            recorder.advertise(topic)
        recorder.publish(topics.ROBOT_DESCRIPTION, b"the arm")
        with session_as(Role.RECORDER, keys, mode="client", connect__endpoints=[router]) as viewer:
            ear = zenoh.ext.declare_advanced_subscriber(
                viewer, key, lambda s: received.update(arm=s.payload.to_bytes()), history=late
            )
            tf = viewer.declare_subscriber(
                topics.TF.key_expression(0), lambda s: received.update(tf=s.payload.to_bytes())
            )

            def is_seen() -> bool:
                recorder.publish(topics.TF, b"where it is")
                return received == {"arm": b"the arm", "tf": b"where it is"}

            await_true(is_seen)
            ear.undeclare()
            tf.undeclare()
        recorder.close()


def session_as(role: Role, keys: KeyFolder, **settings: Any) -> zenoh.Session:
    """A foreign session, with the certificate of a role and without its rules."""
    given = {name.replace("__", "/"): value for name, value in settings.items()}
    return foreign_session({**tls(keys, role), "scouting/multicast/enabled": False, **given})


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

    reported = {progress_key_expression(7), missed_key_expression(7)}
    bundles = {role: bundle_key_expression(7, role) for role in (Role.PLANT, Role.CONTROLLER)}
    assert puts("egress") == {*keys_of(Role.PLANT, None), bundles[Role.PLANT]}
    assert puts("ingress") == {
        *keys_of(Role.PLANT, Role.CONTROLLER, None), *reported, *bundles.values()
    }  # fmt: skip
    for rule in rules:
        if rule["id"].startswith("plant from recorder"):
            assert "put" not in rule["messages"] or set(rule["key_exprs"]) == reported
            speaks = rule["messages"] == ["liveliness_token"]
            assert (recorded_key_expression(7) in rule["key_exprs"]) == (
                speaks or "liveliness" in rule["messages"][0]
            )
