"""Sessions as rmw_zenoh opens them by default: its router, and its nodes, which are peers.

The settings are those of its ``DEFAULT_RMW_ZENOH_{ROUTER,SESSION}_CONFIG.json5`` that differ from
Zenoh's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from tests.bus_schema.zenoh.zenoh_pair import foreign_session

_PATIENT = {
    "transport/unicast/open_timeout": 60_000,
    "transport/unicast/accept_timeout": 60_000,
    "transport/unicast/accept_pending": 10_000,
    "transport/unicast/max_sessions": 10_000,
    "transport/link/tx/lease": 60_000,
    "transport/link/tx/keep_alive": 2,
}
_COMMON = {
    **_PATIENT,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
    "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
    "timestamping/enabled": True,
    "queries_default_timeout": 600_000,
}
_ROUTER = {
    **_COMMON,
    "mode": "router",
    "routing/router/peers_failover_brokering": False,
    "scouting/gossip/autoconnect_strategy": {
        "router": {"to_router": "always", "to_peer": "always"}
    },
}
_NODE = {
    **_COMMON,
    "mode": "peer",
    "scouting/gossip/autoconnect_strategy": {
        "peer": {"to_router": "always", "to_peer": "greater-zid"}
    },
}


@contextmanager
def rmw_router(endpoint: str) -> Iterator[zenoh.Session]:
    """What ``ros2 run rmw_zenoh_cpp rmw_zenohd`` starts, at an endpoint of its own."""
    with foreign_session({**_ROUTER, "listen/endpoints": [endpoint]}) as session:
        yield session


@contextmanager
def rmw_node(router_endpoint: str) -> Iterator[zenoh.Session]:
    """A ROS 2 node's session."""
    endpoints = {"connect/endpoints": [router_endpoint], "listen/endpoints": ["tcp/localhost:0"]}
    with foreign_session({**_NODE, **endpoints}) as session:
        yield session
