"""Whoever waits in vain is told what to check; refusals are silent on the wire."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bus_schema.link.configuration import LinkConfiguration, SecurityConfiguration
from bus_schema.link.key_files import KeyFolder
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.zenoh import diagnosis as silence
from bus_schema.zenoh.diagnosis import SilenceWatch, explain_silence
from bus_schema.zenoh.link import ZenohPlantLink
from deploy.processes.network.free_ports import free_ports
from deploy.processes.network.keys import create_authority, issue

PATIENT_S = 60.0


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever answers is waited for, on a busy machine too."""
    monkeypatch.setattr(silence, "_PROBE_S", PATIENT_S)


def make_link(port: int, folder: Path | None = None) -> LinkConfiguration:
    security = SecurityConfiguration(enabled=folder is not None, folder=str(folder or "/nowhere"))
    return LinkConfiguration(security=security, plant_endpoint=f"tcp/127.0.0.1:{port}")


@contextmanager
def plant_at(link: LinkConfiguration) -> Iterator[None]:
    plant = ZenohPlantLink(link, MonotonicClock(), lockstep=True)
    try:
        yield
    finally:
        plant.close()


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Keys; keys of another authority; keys for another host."""
    paths = tuple(
        tmp_path_factory.mktemp("keys") / name for name in ("ours", "others", "elsewhere")
    )
    for path, host in zip(paths, ("127.0.0.1", "127.0.0.1", "192.0.2.1"), strict=True):
        keys = KeyFolder.at(path)
        create_authority(keys, 1.0)
        for role in Role:
            issue(keys, role, [host], 1.0)
    return paths[0], paths[1], paths[2]


def test_nobody_there(folders: tuple[Path, Path, Path]) -> None:
    for folder in (None, folders[0]):
        said = explain_silence(make_link(free_ports(1)[0], folder), Role.CONTROLLER, Role.PLANT)
        assert "no plant yet after 2 s" in said
        assert "nobody can be reached there (Connection refused)" in said


def test_plaintext_where_tls_is_spoken(folders: tuple[Path, Path, Path]) -> None:
    port = free_ports(1)[0]
    with plant_at(make_link(port, folders[0])):
        said = explain_silence(make_link(port), Role.CONTROLLER, Role.PLANT)
    assert "link.security (off here)" in said


def test_tls_where_plaintext_is_spoken(
    folders: tuple[Path, Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(silence, "_PROBE_S", 0.2)
    port = free_ports(1)[0]
    with plant_at(make_link(port)):
        said = explain_silence(make_link(port, folders[0]), Role.CONTROLLER, Role.PLANT)
    assert "does not speak TLS" in said
    assert "is link.security on there too?" in said


@pytest.mark.parametrize(
    ("theirs", "ours", "finding"),
    [
        (0, 1, "unable to get local issuer certificate"),
        (2, 2, "IP address mismatch"),
    ],
    ids=["another authority", "another host"],
)
def test_certificate_of_the_other_side_is_not_accepted(
    folders: tuple[Path, Path, Path], theirs: int, ours: int, finding: str
) -> None:
    port = free_ports(1)[0]
    with plant_at(make_link(port, folders[theirs])):
        said = explain_silence(make_link(port, folders[ours]), Role.CONTROLLER, Role.PLANT)
    assert "certificate is not accepted" in said
    assert finding in said


def test_other_side_does_not_accept_ours(folders: tuple[Path, Path, Path], tmp_path: Path) -> None:
    keys = KeyFolder.at(tmp_path)
    for name in ("controller.crt", "controller.key"):
        (tmp_path / name).write_bytes((folders[1] / name).read_bytes())
    keys.authority.write_bytes((folders[0] / "authority.crt").read_bytes())
    port = free_ports(1)[0]
    with plant_at(make_link(port, folders[0])):
        said = explain_silence(make_link(port, tmp_path), Role.CONTROLLER, Role.PLANT)
    assert "it refuses our certificate for the role controller" in said


def test_wrong_role_at_the_endpoint(folders: tuple[Path, Path, Path]) -> None:
    port = free_ports(1)[0]
    with plant_at(make_link(port, folders[0])):
        link = LinkConfiguration(
            security=SecurityConfiguration(enabled=True, folder=str(folders[0])),
            controller_endpoint=f"tcp/127.0.0.1:{port}",
        )
        said = explain_silence(link, Role.RECORDER, Role.CONTROLLER)
    assert "the certificate there is for the role 'plant'" in said


def test_nothing_wrong_to_be_found(
    folders: tuple[Path, Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(silence, "_PROBE_S", 3.0)  # so long no refusal comes
    port = free_ports(1)[0]
    with plant_at(make_link(port, folders[0])):
        said = explain_silence(make_link(port, folders[0]), Role.CONTROLLER, Role.PLANT)
    assert "is it still starting?" in said


@pytest.mark.parametrize("secured", [False, True])
def test_listener_is_told_what_keeps_visitors_away(
    folders: tuple[Path, Path, Path], secured: bool
) -> None:
    link = make_link(7451, folders[0] if secured else None)
    said = explain_silence(link, Role.PLANT, Role.CONTROLLER)
    assert f"no controller yet after 2 s at {'tls' if secured else 'tcp'}/127.0.0.1:7451" in said
    assert ("certificate for the role controller" in said) == secured
    assert ("It is off here" in said) == (not secured)


def test_warning_comes_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = SilenceWatch(make_link(free_ports(1)[0]), Role.PLANT, Role.CONTROLLER)
    watch.look()
    assert caplog.records == []  # two seconds have not passed
    monkeypatch.setattr(silence, "SILENCE_S", 0.0)
    watch = SilenceWatch(make_link(free_ports(1)[0]), Role.PLANT, Role.CONTROLLER)
    for _ in range(3):
        watch.look()
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
