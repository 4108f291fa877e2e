"""`run` listens where its scenario says, and on free ports where it says nothing."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from deploy.run.network.links import free_ports, with_free_endpoints
from deploy.scenario.effective import effective_values
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError

DEFAULTS = {"tcp/127.0.0.1:7451", "tcp/127.0.0.1:7452"}


def endpoints(*overrides: str, scenario: str = "paper_arm") -> tuple[str, str]:
    link = with_free_endpoints(load_setup(scenario, overrides)).scenario.link
    return link.plant_endpoint, link.controller_endpoint


def test_defaults_give_way_to_free_ports() -> None:
    chosen = endpoints()
    assert len({*chosen}) == 2
    assert not DEFAULTS & {*chosen}
    assert all(endpoint.startswith("tcp/127.0.0.1:") for endpoint in chosen)


def test_free_ports_are_none_that_linux_gives_to_connections_that_go_out() -> None:
    """From 32768 on a free port may be taken before its process listens."""
    assert max(free_ports(50)) < 32_768


def test_defaults_keep_their_protocol() -> None:
    assert all(each.startswith("tls/") for each in endpoints("link.security.enabled=true"))


def test_endpoint_that_is_set_is_used() -> None:
    (port,) = free_ports(1)
    given = f"tcp/127.0.0.1:{port}"
    plant, controller = endpoints(f"link.plant_endpoint={given}")
    assert plant == given
    assert controller not in {given, *DEFAULTS}


def test_endpoint_of_the_scenario_file_is_used(tmp_path: Path) -> None:
    (port,) = free_ports(1)
    given = f"udp/0.0.0.0:{port}"
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: paper_arm\nlink: {{controller_endpoint: {given}}}\n")
    assert endpoints(scenario=str(file))[1] == given


def can_place(*overrides: str) -> tuple[str, int]:
    can = with_free_endpoints(load_setup("paper_arm_can", overrides)).scenario.link.can
    return can.resolved_channel, can.port


def test_each_run_has_a_multicast_bus_of_its_own() -> None:
    (group, port), (other_group, other_port) = can_place(), can_place()
    assert (group, port) != (other_group, other_port)
    assert 43_113 not in {port, other_port}
    assert group.startswith("239.74.")


def test_multicast_bus_that_is_given_is_used() -> None:
    assert can_place("link.can.port=43113") == ("239.74.163.2", 43_113)
    assert can_place("link.can.channel=239.1.2.3") == ("239.1.2.3", 43_113)
    assert can_place("link.can.interface=socketcan") == ("vcan0", 43_113)


def test_children_receive_the_bus_and_the_saved_scenario_does_not() -> None:
    setup = load_setup("paper_arm_can")
    reported = effective_values(with_free_endpoints(setup))["link"]["can"]
    assert {"channel", "port"} <= reported.keys()
    assert not {"channel", "port"} & effective_values(setup)["link"]["can"].keys()


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_endpoint_that_is_in_use_is_refused(protocol: str) -> None:
    kind = socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM
    with socket.socket(type=kind) as listener:
        listener.bind(("127.0.0.1", 0))
        if protocol == "tcp":
            listener.listen()
        given = f"{protocol}/127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(ScenarioError, match=rf"link\.plant_endpoint = '{given}': must be an"):
            endpoints(f"link.plant_endpoint={given}")


def test_one_endpoint_for_both_is_refused() -> None:
    (port,) = free_ports(1)
    both = [f"link.{role}_endpoint=tcp/127.0.0.1:{port}" for role in ("plant", "controller")]
    with pytest.raises(ScenarioError, match="Address already in use"):
        endpoints(*both)


@pytest.mark.parametrize(
    "given",
    [
        "tcp/192.0.2.1:7451", "tcp/127.0.0.1:99999", "tcp/no.such.:1", "tcp/a..b:1",
        "tcp/127.0.0.1:0",
    ],
)  # fmt: skip
def test_endpoint_of_no_place_on_this_machine_is_refused(given: str) -> None:
    with pytest.raises(ScenarioError, match=r"link\.controller_endpoint"):
        endpoints(f"link.controller_endpoint={given}")
