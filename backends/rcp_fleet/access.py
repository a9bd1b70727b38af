"""The rules of a hub's router: what the holder of each certificate may say, and to whom it listens.

Routers decide by the common name of the certificate. Only what comes in is limited: what goes out
follows the subscriptions, and they came in.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

__all__ = ["access_rules"]

_SAY = ["put", "delete", "liveliness_token"]
_HEAR = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
_ALL = ["put", "delete", "declare_subscriber", "declare_queryable", "query", "reply"]
_LIVE = ["liveliness_token", "declare_liveliness_subscriber", "liveliness_query"]


def access_rules(
    tenant: str, robots: Iterable[str], hubs: Iterable[str], routers: Iterable[str] = ()
) -> dict[str, Any]:
    """Return the access control of a router for the robots and the other hubs of a tenant.

    `routers` are hubs whose own routers are linked with it: they speak for everybody there.
    """
    rules: list[dict[str, Any]] = [_rule("out", [*_ALL, *_LIVE], ["**"], "egress")]
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for kind, names, of in (
        ("robot", robots, _of_robot),
        ("hub", hubs, _of_hub),
        ("router", routers, _of_router),
    ):
        for name in names:
            id_ = f"{kind} {name}"
            say, hear = of(tenant, name)
            rules += [_rule(f"{id_} says", _SAY, say), _rule(f"{id_} hears", _HEAR, hear)]
            subjects.append({"id": id_, "cert_common_names": [name]})
            policies.append({"subjects": [id_], "rules": ["out", f"{id_} says", f"{id_} hears"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _of_robot(tenant: str, name: str) -> tuple[list[str], list[str]]:
    own = f"rcp/{tenant}/{name}"
    return (
        [f"{own}/alive", f"{own}/out/**", f"{own}/data/**"],
        [f"{own}/in/**", f"{own}/link/**", f"rcp/{tenant}/revoked"],
    )


def _of_hub(tenant: str, name: str) -> tuple[list[str], list[str]]:
    every = f"rcp/{tenant}/*"
    return (
        [f"{every}/in/{name}/**", f"{every}/link/{name}/**", f"rcp/{tenant}/revoked"],
        [f"{every}/alive", f"{every}/out/{name}/**", f"{every}/data/**", f"{every}/link/{name}/**"],
    )


def _of_router(tenant: str, _: str) -> tuple[list[str], list[str]]:
    every = [f"rcp/{tenant}/**"]
    return every, every


def _rule(id_: str, messages: list[str], keys: list[str], flow: str = "ingress") -> dict[str, Any]:
    return {
        "id": id_,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    }
