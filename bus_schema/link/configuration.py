"""Section ``link`` of a scenario: which bus, where, and what it does to the messages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator

from bus_schema.configuration import NonNegative, Positive, StrictModel, Whole
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.messages.topics import Role
from bus_schema.registry import NameIn

AUTO: Final = "auto"
"""Play-out time that the controller chooses, and says with each command."""
_NO_DUPLICATES = "must be left out with link.transport: tcp, which delivers nothing twice"
DEFAULT_FOLDER = "~/.config/funnel-hil/keys"


@dataclass(frozen=True)
class KeyFolder:
    """The folder of keys and certificates: flat, with the same file names on every host.

    A host needs ``authority.crt`` and the two files of each role it plays. The authority's own key
    is needed to issue certificates, and belongs on no host that takes part in a run.

    Attributes:
        path: the folder.
    """

    path: Path

    @staticmethod
    def at(folder: str | Path) -> KeyFolder:
        """Return the folder at this path; ``~`` is the user's home.

        Raises:
            FileNotFoundError: the user has no home.
        """
        try:
            return KeyFolder(Path(folder).expanduser())
        except RuntimeError as error:
            raise FileNotFoundError(f"{folder}: {error}; use an absolute path") from error

    @property
    def authority(self) -> Path:
        """Certificate of the authority that all peers trust."""
        return self.path / "authority.crt"

    @property
    def authority_key(self) -> Path:
        """Private key of the authority."""
        return self.path / "authority.key"

    def certificate(self, role: Role) -> Path:
        """Certificate of a role."""
        return self.path / f"{role}.crt"

    def key(self, role: Role) -> Path:
        """Private key of a role."""
        return self.path / f"{role}.key"


def _check_endpoint(text: str) -> str:
    if not re.fullmatch(r"(tcp|udp|tls|quic|ws)/\S+:\d{1,5}|unixsock-stream/\S+", text):
        raise ValueError("a Zenoh endpoint such as tcp/127.0.0.1:7451")
    return text


Endpoint = Annotated[str, AfterValidator(_check_endpoint)]


def _check_folder(text: str) -> str:
    if not text.startswith(("/", "~")):
        raise ValueError("an absolute path, or one that begins with ~")
    return text


def _check_playout(value: object) -> object:
    # A union of types would report each of its parts, by names that no scenario has.
    is_time = isinstance(value, (int, float)) and value >= 0.0 and not isinstance(value, bool)
    if value is not None and value != AUTO and not is_time:
        raise ValueError(f"a number of ms, at least 0, or {AUTO}")
    return value


PlayoutTime = Annotated[Literal["auto"] | NonNegative | None, BeforeValidator(_check_playout)]


class SecurityConfiguration(StrictModel):
    """Mutual TLS, and access to topics by role.

    Attributes:
        enabled: accept only peers with a certificate of the authority, each in its role.
        folder: folder of keys and certificates (`funnel-hil keys`); absolute, or from ``~``.
    """

    enabled: bool = False
    folder: Annotated[str, AfterValidator(_check_folder)] = DEFAULT_FOLDER

    @property
    def keys(self) -> KeyFolder:
        return KeyFolder.at(self.folder)


class LinkConfiguration(StrictModel, validate_default=True):
    """The link between controller and plant.

    Attributes:
        kind: ``zenoh`` between processes, ``in_process`` within one (for ``simulate``), ``can`` for
            joint states and torques on a CAN bus (telemetry still goes over Zenoh).
        domain: ROS domain, the first part of every key.
        security: keys and certificates; if enabled, every ``tcp/`` endpoint below becomes ``tls/``.
        plant_endpoint: where the plant listens.
        controller_endpoint: where the controller listens, for recorders.
        router_endpoint: a Zenoh router that every process also connects to, so that ROS 2 nodes
            find them.
        publish_reference: the plant sends `joint_reference` with every state, for controllers that
            do not know the scenario.
        publish_clock: the plant sends `clock` before each state, for ROS 2 nodes with
            ``use_sim_time``.
        uplink: plant to controller.
        downlink: controller to plant.
        transport: ``udp``: messages are lost; ``tcp``: a lost one is sent again, and all that
            follow wait for it.
        playout_ms: a command acts no earlier than this after the stamp of the state that it
            answers; 0 for on arrival. With ``auto``, each command says when it acts, and the
            controller learns from the plant how late commands arrive; the default with
            ``controller.delay_compensation``, but not over CAN.
        deadline_ms: largest age of the state that the command in force answers; by default one
            period beyond the mean round trip, or the play-out if longer.
        connect_timeout_s: wall time that a process waits for its peers at the start.
        reply_timeout_s: wall time that a process waits for a silent peer during a run.
        can: the CAN bus and its drives, with ``kind: can`` and for `drives`.
    """

    kind: Annotated[str, BeforeValidator(str), NameIn("link_kinds")] = "zenoh"
    domain: Annotated[Whole, Field(ge=0, le=232)] = 0
    security: SecurityConfiguration = SecurityConfiguration()
    plant_endpoint: Endpoint = "tcp/127.0.0.1:7451"
    controller_endpoint: Endpoint = "tcp/127.0.0.1:7452"
    router_endpoint: Endpoint | None = None
    publish_reference: bool = False
    publish_clock: bool = False
    uplink: ChannelConfiguration = ChannelConfiguration()
    downlink: ChannelConfiguration = ChannelConfiguration()
    transport: Literal["udp", "tcp"] = "udp"
    playout_ms: PlayoutTime = None
    deadline_ms: Positive | None = None
    connect_timeout_s: Positive = 20.0
    reply_timeout_s: Positive = 5.0
    can: CanConfiguration = CanConfiguration()

    @field_validator("plant_endpoint", "controller_endpoint", "router_endpoint")
    @classmethod
    def _secure(cls, endpoint: str | None, info: ValidationInfo) -> str | None:
        """Endpoints follow the switch, so that there is one switch and not four."""
        security = info.data.get("security")
        if endpoint is None or security is None:
            return endpoint
        protocol, address = endpoint.split("/", maxsplit=1)
        if security.enabled:
            if protocol not in ("tcp", "tls"):
                raise ValueError("a tls/ or tcp/ endpoint if link.security.enabled is true")
            return f"tls/{address}"
        if protocol in ("tls", "quic"):
            raise ValueError("of another protocol, or link.security.enabled true")
        return endpoint

    @field_validator("transport")
    @classmethod
    def _check_transport(cls, transport: str, info: ValidationInfo) -> str:
        if transport == "udp":
            return transport
        if info.data.get("kind") == "can":
            raise ValueError("udp with link.kind = can: a bus has no streams")
        ways = (info.data.get(name) for name in ("uplink", "downlink"))
        if any(way is not None and way.has_duplicates for way in ways):
            raise ValueError("udp with a duplicate: TCP delivers nothing twice")
        return transport

    @property
    def no_duplicates(self) -> str | None:
        """Rule that refuses duplicated messages; None if the transport has them."""
        return _NO_DUPLICATES if self.transport == "tcp" else None

    def listen_endpoint(self, role: Role) -> str:
        """Return where plant or controller listen; recorders connect to both, and do not."""
        return self.plant_endpoint if role is Role.PLANT else self.controller_endpoint

    @property
    def plays_automatically(self) -> bool:
        """Whether each command says when it acts."""
        return self.playout_ms == AUTO

    @property
    def playout_ns(self) -> int:
        """The fixed time from a state until the command that answers it acts; 0 without one."""
        return round(self.playout_ms * 1e6) if isinstance(self.playout_ms, float) else 0

    @property
    def emulated_round_trip_ns(self) -> int:
        """Sum of ``delay_ms`` of both directions, ns, without jitter."""
        return self.uplink.delay_ns + self.downlink.delay_ns

    def deadline_ns(self, period_ns: int, mean_round_trip_ns: int) -> int:
        """The deadline for this tick period and what a round trip takes on average."""
        if self.deadline_ms is not None:
            return round(self.deadline_ms * 1e6)
        return period_ns + mean_round_trip_ns
