"""Places for CAN buses on UDP multicast that no other test has, be it in another process."""

from __future__ import annotations

from deploy.run.network.links import free_ports


def own_place() -> tuple[str, int]:
    """Group and port."""
    (port,) = free_ports(1)
    return f"239.74.{port >> 8}.{1 + port % 250}", port


def own_bus() -> list[str]:
    """The same as overrides of a scenario."""
    group, port = own_place()
    return [
        "link.can.interface=udp_multicast", f"link.can.channel={group}", f"link.can.port={port}",
    ]  # fmt: skip
