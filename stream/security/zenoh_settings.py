"""Zenoh's settings for credentials: mutual TLS, and access control by the common name of a certificate."""

from typing import Any

from stream.identity import EVERYTHING
from stream.security.credentials import CERTIFICATE, KEY, SITE_CERTIFICATE, Credentials
from stream.security.rights import ACCESS_KEY, Principal, rights_of

_TLS = "transport/link/tls"
_PUBLISHING, _READING = ["put", "delete"], ["declare_subscriber"]
_QUERYING, _ANSWERING = ["query"], ["declare_queryable", "reply"]


def tls_settings(credentials: Credentials, *, listens: bool) -> dict[str, Any]:
    """Certificates of both sides are required; a link ends with its certificate."""
    certificate, key = str(credentials.folder / CERTIFICATE), str(credentials.folder / KEY)
    settings: dict[str, Any] = {
        "transport/link/protocols": ["tls"],
        f"{_TLS}/root_ca_certificate": str(credentials.folder / SITE_CERTIFICATE),
        f"{_TLS}/enable_mtls": True, f"{_TLS}/verify_name_on_connect": True, f"{_TLS}/close_link_on_expiration": True,
        f"{_TLS}/connect_certificate": certificate, f"{_TLS}/connect_private_key": key,
    }  # fmt: skip
    if listens:
        settings |= {f"{_TLS}/listen_certificate": certificate, f"{_TLS}/listen_private_key": key}
    return settings


def access_control(credentials: Credentials, *, is_read_only: bool = False) -> dict[str, Any]:
    """Rules of who listens: each principal of the access list has its rights, everything else is dropped.

    Zenoh sees the certificate of the last hop only. With `is_read_only` nobody may publish.
    """
    rules: list[dict[str, Any]] = [
        # anybody with a certificate of the site may ask whether it is admitted
        _rule("asks", ["query"], "ingress", [ACCESS_KEY]),
        _rule("asked", ["reply", "declare_queryable"], "egress", [ACCESS_KEY]),
    ]
    subjects: list[dict[str, Any]] = [{"id": "anybody"}]
    policies: list[dict[str, Any]] = [{"rules": ["asks", "asked"], "subjects": ["anybody"]}]
    for principal in sorted(credentials.access.admitted):
        own = _rules(principal, is_read_only=is_read_only)
        name = principal.common_name
        rules += own
        subjects.append({"id": name, "cert_common_names": [name]})
        policies.append({"rules": [each["id"] for each in own], "subjects": [name]})
    return {
        "enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies
    }  # fmt: skip


def _rules(principal: Principal, *, is_read_only: bool) -> list[dict[str, Any]]:
    rights, name = rights_of(principal), principal.common_name
    wanted = [
        ("publishes", _PUBLISHING, "ingress", () if is_read_only else rights.publishes),
        ("finds subscribers", _READING, "egress", (*rights.publishes, EVERYTHING)),
        ("subscribes", _READING, "ingress", rights.reads),
        ("reads", _PUBLISHING, "egress", rights.reads),
        ("queries", _QUERYING, "ingress", rights.queries),
        ("gets answers", _ANSWERING, "egress", rights.queries),
        ("answers", _ANSWERING, "ingress", rights.answers),
        ("is queried", _QUERYING, "egress", rights.answers),
    ]
    return [_rule(f"{name} {what}", messages, flow, list(keys)) for what, messages, flow, keys in wanted if keys]


def _rule(name: str, messages: list[str], flow: str, keys: list[str]) -> dict[str, Any]:
    return {"id": name, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": keys}
