"""Keys: a private certificate authority, and a certificate for each role.

A certificate's common name is the role of its holder; access control checks nothing else. Keys are
ECDSA on P-256 in PKCS #8. Private keys are readable only by their owner, and stored only in their
own files.
"""

from __future__ import annotations

import datetime as dt
import ipaddress
import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import Role
from bus_schema.user_files import read_bytes
from deploy.scenario.yaml_files import ScenarioError

AUTHORITY_NAME = "funnel-hil authority"
_CLOCKS_DIFFER_BY = dt.timedelta(minutes=5)
_SERVER, _CLIENT = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH


def create_authority(keys: KeyFolder, days: float) -> None:
    """Create an authority, in a folder that only its owner can read.

    Args:
        keys: the folder; created if it does not exist.
        days: how long the authority is valid.

    Raises:
        ScenarioError: there is one already, or the folder cannot be written to.
    """
    if keys.authority_key.exists():
        raise ScenarioError(f"{keys.authority_key}: exists; choose another --folder or remove it")
    try:
        keys.path.mkdir(parents=True, exist_ok=True)
        keys.path.chmod(0o700)
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(AUTHORITY_NAME)
        certificate = (
            _builder(name, name, key, days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(key_cert_sign=True, crl_sign=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        _write(keys.authority, certificate, keys.authority_key, key)
    except OSError as error:
        raise ScenarioError(f"--folder {keys.path}: {error.strerror}") from error


def issue(keys: KeyFolder, role: Role, hosts: Sequence[str], days: float) -> x509.Certificate:
    """Issue a certificate with a new private key to a role, replacing its old one.

    Args:
        keys: the folder of the authority.
        role: becomes the common name.
        hosts: host names and addresses of its endpoint.
        days: how long it is valid; never longer than the authority.

    Raises:
        ScenarioError: there is no authority, or a host is invalid.
    """
    remedy = f"run `funnel-hil keys init --folder {keys.path}`"
    authority = read_certificate(keys.authority, remedy)
    authority_key = _read_key(keys.authority_key, remedy)
    key = ec.generate_private_key(ec.SECP256R1())
    builder = (
        _builder(_name(role), authority.subject, key, days, authority.not_valid_after_utc)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(digital_signature=True), critical=True)
        .add_extension(x509.ExtendedKeyUsage(_purposes(role)), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()),
            critical=False,
        )
    )
    if role is not Role.RECORDER:
        names = x509.SubjectAlternativeName([_general_name(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    certificate = builder.sign(authority_key, hashes.SHA256())
    try:
        _write(keys.certificate(role), certificate, keys.key(role), key)
    except OSError as error:
        raise ScenarioError(f"--folder {keys.path}: {error.strerror}") from error
    return certificate


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Return the host names and addresses in a certificate."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names]


def common_name(certificate: x509.Certificate) -> str:
    """Return the role in a certificate; empty if it has none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def check_keys(keys: KeyFolder, roles: Iterable[Role]) -> None:
    """Check, before anything starts, that these roles have the keys that link.security needs.

    Raises:
        ScenarioError: a file is missing, unreadable, expired, of another role, of another
            authority, or readable by others; the message says what to do.
    """
    remedy = f"run `funnel-hil keys init --folder {keys.path}`"
    authority = read_certificate(keys.authority, remedy)
    _require_valid_now(keys.authority, authority, f"remove the folder and {remedy}")
    for role in roles:
        _check_role(keys, role, authority)


def read_certificate(path: Path, remedy: str) -> x509.Certificate:
    """Read a certificate.

    Args:
        path: its file.
        remedy: what to do if there is none.

    Raises:
        ScenarioError: there is none.
    """
    try:
        return x509.load_pem_x509_certificate(_read(path, remedy))
    except ValueError as error:
        raise ScenarioError(f"{path}: is not a PEM certificate: {remedy}") from error


def _check_role(keys: KeyFolder, role: Role, authority: x509.Certificate) -> None:
    path = keys.certificate(role)
    remedy = f"run `funnel-hil keys issue {role} --folder {keys.path}`"
    certificate = read_certificate(path, remedy)
    if common_name(certificate) != role:
        problem = f"is a certificate for {common_name(certificate)!r}, not for {role.value!r}"
        raise ScenarioError(f"{path}: {problem}: {remedy}")
    _require_valid_now(path, certificate, remedy)
    try:
        certificate.verify_directly_issued_by(authority)
    except Exception as error:  # the exception depends on the kind of key that signed
        raise ScenarioError(f"{path}: is not issued by {keys.authority}: {remedy}") from error
    key = _read_key(keys.key(role), remedy)
    if key.public_key() != certificate.public_key():
        raise ScenarioError(f"{keys.key(role)}: does not belong to {path}: {remedy}")


def _require_valid_now(path: Path, certificate: x509.Certificate, remedy: str) -> None:
    now = dt.datetime.now(dt.UTC)
    if now > certificate.not_valid_after_utc:
        raise ScenarioError(f"{path}: expired at {certificate.not_valid_after_utc}: {remedy}")
    if now < certificate.not_valid_before_utc:
        since = certificate.not_valid_before_utc
        raise ScenarioError(f"{path}: is valid from {since} on: check this machine's clock")


def _read_key(path: Path, remedy: str) -> ec.EllipticCurvePrivateKey:
    pem = _read(path, remedy)
    mode, handed_over = path.stat().st_mode, os.environ.get("CREDENTIALS_DIRECTORY")
    # systemd passes keys on with an access list, whose mask is shown as the group's rights.
    is_credential = handed_over is not None and path.resolve().is_relative_to(handed_over)
    if mode & (stat.S_IRWXO if is_credential else stat.S_IRWXO | stat.S_IRWXG):
        shown = stat.filemode(mode)
        raise ScenarioError(f"{path}: others may read it ({shown}): run `chmod 600 {path}`")
    try:
        key = serialization.load_pem_private_key(pem, password=None)
    except (ValueError, TypeError) as error:
        raise ScenarioError(f"{path}: is not a PEM private key: {remedy}") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ScenarioError(f"{path}: is not an elliptic-curve key: {remedy}")
    return key


def _read(path: Path, remedy: str) -> bytes:
    try:
        return read_bytes(path)
    except FileNotFoundError as error:
        raise ScenarioError(f"{path}: does not exist: {remedy}") from error
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror or error}") from error


def _purposes(role: Role) -> list[x509.ObjectIdentifier]:
    """Return a role's extended key usage: a recorder only connects, and must not be a server."""
    return [_CLIENT] if role is Role.RECORDER else [_CLIENT, _SERVER]


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        if not host or any(character.isspace() or character in "/:" for character in host):
            raise ValueError
        return x509.DNSName(host)
    except ValueError as error:
        raise ScenarioError(f"--host {host!r}: must be a host name or an IP address") from error


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    days: float,
    until: dt.datetime | None = None,
) -> x509.CertificateBuilder:
    now = dt.datetime.now(dt.UTC)
    end = now + dt.timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_DIFFER_BY)
        .not_valid_after(end if until is None else min(end, until))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _usage(**allowed: bool) -> x509.KeyUsage:
    uses = (
        "digital_signature", "content_commitment", "key_encipherment", "data_encipherment",
        "key_agreement", "key_cert_sign", "crl_sign", "encipher_only", "decipher_only",
    )  # fmt: skip
    return x509.KeyUsage(**{use: allowed.get(use, False) for use in uses})


def _write(
    certificate_file: Path,
    certificate: x509.Certificate,
    key_file: Path,
    key: ec.EllipticCurvePrivateKey,
) -> None:
    """Write both files; the key's is created with its final mode, so others can never read it."""
    pem = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    key_file.unlink(missing_ok=True)
    descriptor = os.open(key_file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(pem)
    certificate_file.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
