"""Possible causes of a missing peer: Zenoh refuses silently, so the waiting side has to check.

A connecting process probes the endpoint once and reports the result; a listening process can only
list possible causes.
"""

from __future__ import annotations

import logging
import socket
import ssl
import time

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages.topics import Role

logger = logging.getLogger(__name__)

SILENCE_S = 2.0
"""Time without a peer before its absence is reported."""
_PROBE_S = 1.0


class SilenceWatch:
    """Warns once, after two seconds without a peer.

    Args:
        link: section ``link`` of the scenario.
        role: what this process is.
        peer: the role it waits for.
    """

    def __init__(self, link: LinkConfiguration, role: Role, peer: Role) -> None:
        self._link, self._role, self._peer = link, role, peer
        self._warn_at_s: float | None = time.monotonic() + SILENCE_S

    def look(self) -> None:
        """Check once; call it repeatedly while the peer is missing."""
        if self._warn_at_s is not None and time.monotonic() >= self._warn_at_s:
            self._warn_at_s = None
            logger.warning("%s", explain_silence(self._link, self._role, self._peer))


def explain_silence(link: LinkConfiguration, role: Role, peer: Role) -> str:
    """Explain in one or two sentences why a peer may be missing.

    Args:
        link: section ``link`` of the scenario.
        role: what this process is.
        peer: the missing role.
    """
    start = f"no {peer} yet after {SILENCE_S:g} s"
    if peer is Role.RECORDER or role is Role.PLANT:
        return f"{start} at {link.listen_endpoint(role)}: {_why_nobody_comes(link, peer)}"
    endpoint = link.listen_endpoint(peer)
    finding = _probe(endpoint, link, role, peer) or _why_nobody_answers(link, peer)
    return f"{start} at {endpoint}: {finding}"


def _why_nobody_comes(link: LinkConfiguration, peer: Role) -> str:
    if link.security.enabled:
        return (
            f"is it running, with this endpoint, with link.security on, and with a certificate for"
            f" the role {peer} from the authority in {link.security.keys.authority} that has not"
            " expired? A process without one is refused silently"
        )
    return (
        f"is it running, with this endpoint, with link.domain {link.domain}, and without"
        " link.security? It is off here"
    )


def _why_nobody_answers(link: LinkConfiguration, peer: Role) -> str:
    security = "on" if link.security.enabled else "off"
    return (
        f"a process answers there, but not as the {peer}: do link.domain ({link.domain} here) and"
        f" link.security ({security} here) agree on both sides, and is it still starting?"
    )


def _probe(endpoint: str, link: LinkConfiguration, role: Role, peer: Role) -> str | None:
    """Return what is wrong at a TCP or TLS endpoint; None if a server there accepts us."""
    protocol, _, address = endpoint.partition("/")
    if protocol not in ("tcp", "tls"):
        return None
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    try:
        connection = socket.create_connection((host, int(port)), _PROBE_S)
    except OSError as error:
        return f"no process can be reached there ({error.strerror or error}): is it running?"
    with connection:
        return _shake_hands(connection, host, link, role, peer) if protocol == "tls" else None


def _shake_hands(
    plain: socket.socket, host: str, link: LinkConfiguration, role: Role, peer: Role
) -> str | None:
    """Return what is wrong with a TLS server; None if it accepts us under the expected name."""
    keys = link.security.keys
    try:
        context = ssl.create_default_context(cafile=str(keys.authority))
        context.load_cert_chain(keys.certificate(role), keys.key(role))
        with context.wrap_socket(plain, server_hostname=host) as secure:
            found = _common_name(secure.getpeercert() or {})
            if found != peer:
                return f"the certificate there is for the role {found!r}; link.security refuses it"
            return _our_refusal(secure, role)
    except ssl.SSLCertVerificationError as error:
        return (
            f"its certificate is not accepted ({error.verify_message}): is it from the authority"
            f" in {keys.authority}, not expired, and issued for this host (`keys issue --host`)?"
        )
    except OSError as error:
        return f"it does not speak TLS ({error}): is link.security on there too?"


def _our_refusal(secure: ssl.SSLSocket, role: Role) -> str | None:
    """Wait for a refusal of our certificate, which TLS 1.3 sends only after the handshake."""
    try:
        secure.settimeout(_PROBE_S)
        secure.recv(1)
    except TimeoutError:
        return None
    except OSError as error:
        return f"it refuses our certificate for the role {role} ({error})"
    return None


def _common_name(certificate: object) -> str:
    subject = certificate.get("subject", ()) if isinstance(certificate, dict) else ()
    names = [value for ((kind, value),) in subject if kind == "commonName"]
    return names[0] if names else ""
