"""Quality of service: ask for what is offered, and say in words what does not fit."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from rcp_ros2.config import Qos

__all__ = ["Profile", "clash", "for_publisher", "for_subscription"]

_DEPTH = 10


class Profile(NamedTuple):
    """The part of a QoS profile that decides whether two sides talk."""

    reliable: bool
    latched: bool
    """Transient local: late joiners are given the last values."""
    depth: int = _DEPTH

    def to_ros(self) -> Any:
        """Return it as rclpy takes it."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        return QoSProfile(
            depth=self.depth,
            reliability=(
                ReliabilityPolicy.RELIABLE if self.reliable else ReliabilityPolicy.BEST_EFFORT
            ),
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE
            ),
        )


def _offers(endpoint: Any) -> tuple[bool, bool]:
    profile = endpoint.qos_profile
    return profile.reliability.name == "RELIABLE", profile.durability.name == "TRANSIENT_LOCAL"


def for_subscription(publishers: Iterable[Any], wanted: Qos) -> Profile:
    """Match every publisher: best effort if any is, latched only if all are."""
    offers = [_offers(endpoint) for endpoint in publishers]
    reliable = bool(offers) and all(r for r, _ in offers)
    latched = bool(offers) and all(t for _, t in offers)
    return _override(wanted, reliable=reliable, latched=latched)


def for_publisher(subscriptions: Iterable[Any], wanted: Qos) -> Profile:
    """Match every subscription: reliable suits all, latched is made only for those that ask."""
    latched = any(_offers(endpoint)[1] for endpoint in subscriptions)
    return _override(wanted, reliable=True, latched=latched)


def _override(wanted: Qos, *, reliable: bool, latched: bool) -> Profile:
    if wanted.reliability is not None:
        reliable = wanted.reliability == "reliable"
    if wanted.durability is not None:
        latched = wanted.durability == "transient_local"
    return Profile(reliable, latched, wanted.depth or _DEPTH)


def clash(topic: str, ours: Profile, publishers: Iterable[Any]) -> str | None:
    """Say which publishers a subscription will never hear, and why; None if it hears all."""
    lost: list[str] = []
    for endpoint in publishers:
        reliable, latched = _offers(endpoint)
        where = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
        if ours.reliable and not reliable:
            lost.append(f"{where} publishes best effort and the mapping asks for reliable")
        elif ours.latched and not latched:
            lost.append(f"{where} publishes volatile and the mapping asks for transient local")
    return f"{topic} is not heard in full: {'; '.join(lost)}" if lost else None
