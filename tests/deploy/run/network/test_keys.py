"""Keys are made correctly, and unusable keys are refused before a run."""

from __future__ import annotations

import datetime as dt
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import Role
from deploy.run.network.keys import check_keys, common_name, create_authority, hosts_of, issue
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

DAY = 24 * 3600


@pytest.fixture
def keys(tmp_path: Path) -> KeyFolder:
    return make_keys(tmp_path / "keys")


def make_keys(folder: Path) -> KeyFolder:
    keys = KeyFolder.at(folder)
    create_authority(keys, 10)
    for role in Role:
        issue(keys, role, ["127.0.0.1", "plant.example"], 1)
    return keys


def read(file: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(file.read_bytes())


def test_only_the_owner_can_read_private_keys(keys: KeyFolder) -> None:
    assert stat.S_IMODE(keys.path.stat().st_mode) == 0o700
    for file in (keys.authority_key, *(keys.key(role) for role in Role)):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize("role", Role)
def test_certificate_says_what_access_control_asks_for(keys: KeyFolder, role: Role) -> None:
    certificate = read(keys.certificate(role))
    certificate.verify_directly_issued_by(read(keys.authority))
    assert common_name(certificate) == role
    usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
    assert usage.digital_signature
    assert not usage.key_cert_sign
    basic = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
    assert not basic.ca
    purposes = set(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    serves = role is not Role.RECORDER  # a recorder has no clients
    assert (ExtendedKeyUsageOID.SERVER_AUTH in purposes) == serves
    assert hosts_of(certificate) == (["127.0.0.1", "plant.example"] if serves else [])


def test_validity_is_as_asked_but_never_longer_than_the_authoritys(keys: KeyFolder) -> None:
    now = dt.datetime.now(dt.UTC)
    left_s = (read(keys.certificate(Role.PLANT)).not_valid_after_utc - now).total_seconds()
    assert 0.9 * DAY < left_s <= DAY
    long = issue(keys, Role.PLANT, [], 1000)
    assert long.not_valid_after_utc == read(keys.authority).not_valid_after_utc


def test_serial_numbers_and_keys_differ_with_every_issue(keys: KeyFolder) -> None:
    first, key = read(keys.certificate(Role.PLANT)), keys.key(Role.PLANT).read_bytes()
    second = issue(keys, Role.PLANT, [], 1)
    assert second.serial_number != first.serial_number
    assert keys.key(Role.PLANT).read_bytes() != key


def expire(keys: KeyFolder) -> None:
    issue(keys, Role.PLANT, [], -1 / 1440)


def swap_roles(keys: KeyFolder) -> None:
    for file in (keys.certificate, keys.key):
        file(Role.PLANT).write_bytes(file(Role.RECORDER).read_bytes())


def swap_certificate(keys: KeyFolder) -> None:
    certificate = keys.certificate(Role.PLANT).read_bytes()
    issue(keys, Role.PLANT, [], 1)
    keys.certificate(Role.PLANT).write_bytes(certificate)


def from_elsewhere(keys: KeyFolder) -> None:
    other = make_keys(keys.path.parent / "other")
    for file in (other.certificate(Role.PLANT), other.key(Role.PLANT)):
        (keys.path / file.name).write_bytes(file.read_bytes())


@pytest.mark.parametrize(
    ("spoil", "file", "complaint", "remedy"),
    [
        (lambda k: k.authority.unlink(), "authority.crt", "does not exist", "keys init"),
        (lambda k: k.certificate(Role.PLANT).unlink(), "plant.crt", "does not exist", "keys issue"),
        (lambda k: k.key(Role.PLANT).unlink(), "plant.key", "does not exist", "keys issue plant"),
        (expire, "plant.crt", "expired at", "keys issue plant"),
        (swap_roles, "plant.crt", "is a certificate for 'recorder', not for 'plant'", "keys issue"),
        (swap_certificate, "plant.key", "does not belong to", "keys issue plant"),
        (from_elsewhere, "plant.crt", "is not issued by", "keys issue plant"),
        (lambda k: k.key(Role.PLANT).chmod(0o604), "plant.key", "others may read it", "chmod 600"),
        (lambda k: k.key(Role.PLANT).chmod(0o640), "plant.key", "others may read it", "chmod 600"),
        (
            lambda k: k.key(Role.PLANT).write_bytes(b"?"),
            "plant.key",
            "is not a PEM private key",
            "issue",
        ),
        (
            lambda k: k.certificate(Role.PLANT).write_bytes(b"?"),
            "plant.crt",
            "not a PEM cert",
            "issue",
        ),
    ],
)
def test_unusable_keys_are_refused_with_file_and_remedy(keys, spoil, file, complaint, remedy):
    check_keys(keys, Role)
    spoil(keys)
    with pytest.raises(ScenarioError) as refusal:
        check_keys(keys, [Role.PLANT])
    message = str(refusal.value)
    assert message.startswith(f"{keys.path / file}: ")
    assert complaint in message
    assert remedy in message


def test_a_process_needs_its_own_keys_only(keys: KeyFolder) -> None:
    for file in (keys.authority_key, keys.key(Role.PLANT), keys.certificate(Role.PLANT)):
        file.unlink()
    check_keys(keys, [Role.CONTROLLER])


def test_authority_is_not_replaced_by_accident(keys: KeyFolder) -> None:
    with pytest.raises(ScenarioError, match=r"authority\.key: exists"):
        create_authority(keys, 1)


def test_cli_makes_issues_and_lists(funnel_hil, tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    where = ["--folder", str(folder)]
    assert funnel_hil("keys", "init", *where, "--host", "192.0.2.10")[0] == 0
    check_keys(KeyFolder.at(folder), Role)
    assert "192.0.2.10" in hosts_of(read(folder / "plant.crt"))
    before = read(folder / "recorder.crt").serial_number
    assert funnel_hil("keys", "issue", "plant", "--days", "2", *where)[0] == 0
    assert read(folder / "recorder.crt").serial_number == before
    output = funnel_hil.output("keys", "list", *where)
    for role in Role:
        assert f"{read(folder / f'{role}.crt').serial_number:x}"[:16] in output
    assert funnel_hil("keys", "init", *where)[0] == 2  # there is one already


def test_one_switch_turns_every_endpoint_to_tls() -> None:
    link = load_setup("paper_arm", ["link.security.enabled=true"]).scenario.link
    assert link.plant_endpoint == "tls/127.0.0.1:7451"
    assert link.controller_endpoint == "tls/127.0.0.1:7452"
