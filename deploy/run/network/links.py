"""Requirements of a scenario's link on this machine, checked before anything starts.

It also chooses where the processes of `run` listen: at the scenario's endpoints, or at free ones.
"""

from __future__ import annotations

import contextlib
import random
import socket
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from bus_schema.configuration import ConfigurationError
from bus_schema.messages.topics import Role
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, naming
from plant_emulator.faults.process_faults import process_faults

_KEYS = ("plant_endpoint", "controller_endpoint")
_DATAGRAM_PROTOCOLS = ("udp", "quic")
_PORTS = range(20_000, 32_768)
"""Below the ports of outgoing connections, which could take a port before its process listens."""
_ATTEMPTS = 1000
_lately: deque[int] = deque(maxlen=1000)
"""Ports chosen last, perhaps not in use yet: a second choice must differ."""


def check_link(setup: Setup, *, one_process: bool) -> None:
    """Check that this machine has the requirements of the scenario's link, before anything starts.

    Raises:
        ScenarioError: it does not.
    """
    if one_process:
        require_own_controller(setup)
    with naming(setup.origin):
        setup.link_kind.check_machine(setup.scenario.link, one_process=one_process)


def require_own_controller(setup: Setup) -> None:
    """Check that the scenario's controller is one of ours, not a user's process.

    Raises:
        ScenarioError: it is a user's process.
    """
    process = setup.scenario.controller.process
    if process is not None:
        allowed = "must be null here: run starts it, with clock lockstep in virtual time"
        with naming(setup.origin):
            raise ConfigurationError("controller.process", list(process), allowed)


def require_keys(setup: Setup, *roles: Role) -> None:
    """Check the keys before anything starts; bad keys are bad input.

    Raises:
        ScenarioError: as for `check_keys`.
    """
    security = setup.scenario.link.security
    if security.enabled:
        from deploy.run.network.keys import check_keys  # imports libraries used by no other run

        check_keys(security.keys, roles)


def check_awaiting(setup: Setup) -> None:
    """Check that a remote controller can be awaited, at the scenario's own endpoints.

    Raises:
        ScenarioError: it cannot.
    """
    controller = setup.scenario.controller
    with naming(setup.origin):
        if controller.process is not None:
            allowed = "must be null with --await-controller, because you start the controller"
            raise ConfigurationError("controller.process", list(controller.process), allowed)
        for fault in process_faults(setup.scenario.faults):
            if Role(fault.target) is Role.CONTROLLER:
                allowed = (
                    "must be another process with --await-controller, because funnel-hil"
                    " does not start the controller"
                )
                raise ConfigurationError("faults: target", fault.target, allowed)
    with _refusing(setup, "plant_endpoint"), _listening(setup.scenario.link.plant_endpoint):
        pass


def with_free_endpoints(setup: Setup) -> Setup:
    """Return a scenario with free TCP ports instead of the default endpoints, and a separate bus.

    Endpoints and buses given by the scenario or an override are not changed.

    Raises:
        ScenarioError: a given endpoint cannot be used for listening.
    """
    link = setup.scenario.link
    given = [key for key in _KEYS if key in link.model_fields_set]
    defaults = [key for key in _KEYS if key not in given]
    with contextlib.ExitStack() as stack:
        for key in given:
            with _refusing(setup, key):
                stack.enter_context(_listening(getattr(link, key)))
        ports = zip(defaults, free_ports(len(defaults)), strict=True)
        free = {key: f"{getattr(link, key).rpartition(':')[0]}:{port}" for key, port in ports}
    link = setup.link_kind.with_own_place(link.model_copy(update=free))
    scenario = setup.scenario.model_copy(update={"link": link})
    return replace(setup, scenario=scenario)


@contextlib.contextmanager
def _refusing(setup: Setup, key: str) -> Iterator[None]:
    """Report an endpoint that cannot be used for listening as bad input."""
    endpoint = getattr(setup.scenario.link, key)
    try:
        yield
    except (OSError, OverflowError, UnicodeError) as error:
        key = f"link.{key}"
        raise ScenarioError(
            f"{setup.origin.of(key)}: {key} = {endpoint!r}: must be an"
            f" endpoint that this machine can listen at: {error}"
        ) from error


@contextlib.contextmanager
def _listening(endpoint: str) -> Iterator[None]:
    """Occupy a Zenoh endpoint; an endpoint that is a file is skipped.

    Raises:
        OSError: it is in use, or on another machine.
        OverflowError: there is no such port.
        UnicodeError: there is no such host.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol == "unixsock-stream":
        yield
        return
    if int(port) == 0:
        raise OSError("no client could connect to port 0")
    is_datagram = protocol in _DATAGRAM_PROTOCOLS
    kind = socket.SOCK_DGRAM if is_datagram else socket.SOCK_STREAM
    family, _, _, _, place = socket.getaddrinfo(host.strip("[]"), None, type=kind)[0]
    with socket.socket(family, kind) as listener:
        if not is_datagram:  # otherwise a port stays occupied for a while after its last use
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((place[0], int(port), *place[2:]))
        if not is_datagram:
            listener.listen()
        yield


def free_ports(number: int) -> list[int]:
    """Return unused TCP ports of this machine, different ones in each call.

    Raises:
        OSError: none are found.
    """
    chance = random.SystemRandom()  # a fork would continue its parent's generator
    chosen: list[int] = []
    with contextlib.ExitStack() as stack:
        for _ in range(_ATTEMPTS):
            if len(chosen) == number:
                return chosen
            listener, port = stack.enter_context(socket.socket()), chance.choice(_PORTS)
            if port in _lately:
                continue
            with contextlib.suppress(OSError):
                listener.bind(("127.0.0.1", port))
                chosen.append(port)
                _lately.append(port)
    raise OSError(f"no {number} free TCP ports found from {_PORTS.start} to {_PORTS.stop - 1}")
