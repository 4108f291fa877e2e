"""Zenoh settings for mutual TLS, and the table of topics as access rules.

The common name of its certificate is a peer's role. Every process applies the rules to all that it
receives and sends, so one careful side suffices to stop forbidden messages. Messages that no rule
allows are dropped silently.
"""

from __future__ import annotations

from typing import Any

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import VIEW_TOPICS, Role, topics_of
from bus_schema.zenoh.ros_graph import graph_key_expression, node_tokens


def recorded_key_expression(domain: int, gid: str = "*", session: str = "*") -> str:
    """Liveliness token by which a recorder reports that it has all of one publisher's messages."""
    return f"funnel_hil/{domain}/recorded/{gid}/{session}"


def progress_key_expression(domain: int) -> str:
    """Key of the messages by which recorders report their progress."""
    return f"funnel_hil/{domain}/progress"


def scenario_key_expression(
    domain: int, role: str = "*", session: str = "*", digests: str = "*"
) -> str:
    """Liveliness token by which a process announces its scenario."""
    return f"funnel_hil/{domain}/scenario/{role}/{session}/{digests}"


def bundle_key_expression(domain: int, role: str = "*") -> str:
    """Key of the bundles of a loop."""
    return f"funnel_hil/{domain}/bundles/{role}"


def missed_key_expression(domain: int) -> str:
    """Key of the messages by which recorders request missing bundles."""
    return f"funnel_hil/{domain}/missed"


def bundling_key_expression(domain: int, role: str = "*", session: str = "*") -> str:
    """Liveliness token by which a loop announces that it bundles all its messages."""
    return f"funnel_hil/{domain}/bundling/{role}/{session}"


def secure_settings(role: Role, domain: int, keys: KeyFolder) -> dict[str, Any]:
    """Return the settings of a session that accepts only certificates of our authority.

    Args:
        role: what this process is.
        domain: ROS domain.
        keys: folder of its certificate and key.
    """
    certificate, key = str(keys.certificate(role)), str(keys.key(role))
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(keys.authority),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
        },
        "access_control": access_control(role, domain),
    }


def access_control(role: Role, domain: int) -> dict[str, Any]:
    """Return Zenoh's section ``access_control`` for a process; by default, it denies all."""
    rules, policies = [], []
    for peer in Role:
        own = [*_rules(f"{role} from {peer}", "ingress", peer, domain),
               *_rules(f"{role} to {peer}", "egress", role, domain)]  # fmt: skip
        if role is Role.RECORDER:
            own += _rules_for_viewers(f"{role} for viewers behind {peer}", domain)
        rules += own
        policies.append({"subjects": [peer], "rules": [rule["id"] for rule in own]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": peer, "cert_common_names": [peer]} for peer in Role],
        "policies": policies,
    }


def _rules(name: str, flow: str, speaker: Role, domain: int) -> list[dict[str, Any]]:
    """Return what one process may send to another: every listener may listen, few may send."""
    allowed = {
        "put": [topic.key_expression(domain) for topic in topics_of(speaker)],
        "declare_subscriber": [
            f"{domain}/**", progress_key_expression(domain), bundle_key_expression(domain),
            missed_key_expression(domain),
        ],
        "liveliness_token": [
            node_tokens(domain, speaker), scenario_key_expression(domain, speaker)
        ],
        "declare_liveliness_subscriber": [
            graph_key_expression(domain), recorded_key_expression(domain),
            scenario_key_expression(domain), bundling_key_expression(domain),
        ],
    }  # fmt: skip
    if speaker is Role.RECORDER:
        allowed["put"] += [progress_key_expression(domain), missed_key_expression(domain)]
        allowed["liveliness_token"].append(recorded_key_expression(domain))
    else:
        allowed["put"].append(bundle_key_expression(domain, speaker))
        allowed["liveliness_token"].append(bundling_key_expression(domain, speaker))
    allowed["liveliness_query"] = allowed["declare_liveliness_subscriber"]
    return [
        _rule(f"{name}: {message}", message, [flow], keys)
        for message, keys in allowed.items()
        if keys
    ]


def _rules_for_viewers(name: str, domain: int) -> list[dict[str, Any]]:
    """Return the rules for a recorder's messages to viewers, behind a router of any certificate.

    Late subscribers find and request kept messages under separate keys, which begin with the
    topic's.
    """
    keys = [topic.key_expression(domain) for topic in VIEW_TOPICS]
    kept = [f"{key}/@adv/**" for key in keys]
    allowed = {
        "put": keys,
        "liveliness_token": kept, "declare_liveliness_subscriber": kept, "liveliness_query": kept,
        "declare_queryable": kept, "query": [*keys, *kept], "reply": [*keys, *kept],
    }  # fmt: skip
    return [
        _rule(f"{name}: {message}", message, ["ingress", "egress"], keys)
        for message, keys in allowed.items()
    ]


def _rule(name: str, message: str, flows: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "messages": [message],
        "flows": flows,
        "permission": "allow",
        "key_exprs": keys,
    }
