"""A process that waits in vain reports what to check; refusals are silent on the wire."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from bus_schema.link.configuration import LinkConfiguration, SecurityConfiguration
from bus_schema.messages.topics import Role
from bus_schema.zenoh import diagnosis as silence
from bus_schema.zenoh.diagnosis import SilenceWatch, explain_silence
from deploy.run.network.links import free_ports
from tests.bus_schema.zenoh.zenoh_pair import plant_on
from tests.security import issued_keys

PATIENT_S = 60.0


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever answers is waited for, on a busy machine too."""
    monkeypatch.setattr(silence, "_PROBE_S", PATIENT_S)


def make_link(port: int, folder: Path | None = None) -> LinkConfiguration:
    security = SecurityConfiguration(enabled=folder is not None, folder=str(folder or "/nowhere"))
    return LinkConfiguration(security=security, plant_endpoint=f"tcp/127.0.0.1:{port}")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Keys; keys of another authority; keys for another host."""
    folder = tmp_path_factory.mktemp("keys")
    ours, others = issued_keys(folder / "ours"), issued_keys(folder / "others")
    return ours.path, others.path, issued_keys(folder / "elsewhere", host="192.0.2.1").path


OURS, OTHER_AUTHORITY, OTHER_HOST, PLAINTEXT = 0, 1, 2, None


@pytest.mark.parametrize("keys", [PLAINTEXT, OURS], ids=["plaintext", "tls"])
def test_missing_peer_is_reported(folders: tuple[Path, Path, Path], keys: int | None) -> None:
    link = make_link(free_ports(1)[0], None if keys is None else folders[keys])
    text = explain_silence(link, Role.CONTROLLER, Role.PLANT)
    assert "no plant yet after 2 s" in text
    assert "no process can be reached there (Connection refused)" in text


@pytest.mark.parametrize(
    ("theirs", "ours", "patience_s", "finding"),
    [
        (OURS, PLAINTEXT, PATIENT_S, "link.security (off here)"),
        (PLAINTEXT, OURS, 0.2, "does not speak TLS"),
        (OURS, OTHER_AUTHORITY, PATIENT_S, "unable to get local issuer certificate"),
        (OTHER_HOST, OTHER_HOST, PATIENT_S, "IP address mismatch"),
        (OURS, OURS, 1.0, "is it still starting?"),  # so long no refusal comes
    ],
    ids=["tls there", "plaintext there", "another authority", "another host", "nothing wrong"],
)
def test_what_keeps_the_two_apart_is_named(folders, monkeypatch, theirs, ours, patience_s, finding):
    monkeypatch.setattr(silence, "_PROBE_S", patience_s)
    port = free_ports(1)[0]
    with plant_on(make_link(port, None if theirs is None else folders[theirs])):
        link = make_link(port, None if ours is None else folders[ours])
        assert finding in explain_silence(link, Role.CONTROLLER, Role.PLANT)


def test_other_side_does_not_accept_ours(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    for name in ("controller.crt", "controller.key"):
        (tmp_path / name).write_bytes((folders[OTHER_AUTHORITY] / name).read_bytes())
    (tmp_path / "authority.crt").write_bytes((folders[OURS] / "authority.crt").read_bytes())
    port = free_ports(1)[0]
    with plant_on(make_link(port, folders[OURS])):
        text = explain_silence(make_link(port, tmp_path), Role.CONTROLLER, Role.PLANT)
    assert "it refuses our certificate for the role controller" in text


def test_wrong_role_at_the_endpoint(folders: tuple[Path, Path, Path]) -> None:
    link = make_link(free_ports(1)[0], folders[OURS])
    with plant_on(link):
        swapped = link.model_copy(update={"controller_endpoint": link.plant_endpoint})
        text = explain_silence(swapped, Role.RECORDER, Role.CONTROLLER)
    assert "the certificate there is for the role 'plant'" in text


@pytest.mark.parametrize("secured", [False, True])
def test_listener_reports_why_connections_fail(folders, secured):
    link = make_link(7451, folders[0] if secured else None)
    text = explain_silence(link, Role.PLANT, Role.CONTROLLER)
    assert f"no controller yet after 2 s at {'tls' if secured else 'tcp'}/127.0.0.1:7451" in text
    assert ("certificate for the role controller" in text) == secured
    assert ("It is off here" in text) == (not secured)


def test_warning_comes_once(caplog, monkeypatch):
    watch = SilenceWatch(make_link(free_ports(1)[0]), Role.PLANT, Role.CONTROLLER)
    watch.look()
    assert caplog.records == []  # two seconds have not passed
    monkeypatch.setattr(silence, "SILENCE_S", 0.0)
    watch = SilenceWatch(make_link(free_ports(1)[0]), Role.PLANT, Role.CONTROLLER)
    for _ in range(3):
        watch.look()
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
