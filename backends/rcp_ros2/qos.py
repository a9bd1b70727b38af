"""Quality of service: derive compatible profiles, and describe mismatches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from rcp_ros2.config import Qos

__all__ = [
    "EVER",
    "Profile",
    "Terms",
    "clash",
    "for_publisher",
    "for_subscription",
    "mismatches",
    "unreached_subscribers",
]

_DEPTH = 10
EVER = 2**63 - 1  # ns, the infinity of rclpy


class Profile(NamedTuple):
    """A QoS profile, as far as the two sides of a topic must agree on it."""

    reliable: bool
    latched: bool
    """Transient local: late joiners get the last values."""
    depth: int = _DEPTH
    """Length of the queue; 0 keeps all."""
    deadline: int = EVER
    """Maximum time between two messages, ns."""
    lifespan: int = EVER
    """Lifespan of a message, ns."""
    manual: bool = False
    lease: int = EVER

    def to_ros(self) -> Any:
        """Convert it to an rclpy profile."""
        from rclpy.duration import Duration
        from rclpy.qos import (
            DurabilityPolicy,
            HistoryPolicy,
            LivelinessPolicy,
            QoSProfile,
            ReliabilityPolicy,
        )

        more: dict[str, Any] = {
            key: Duration(nanoseconds=value)
            for key, value in (
                ("deadline", self.deadline),
                ("lifespan", self.lifespan),
                ("liveliness_lease_duration", self.lease),
            )
            if value < EVER
        }
        if self.manual:
            more["liveliness"] = LivelinessPolicy.MANUAL_BY_TOPIC
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST if self.depth else HistoryPolicy.KEEP_ALL,
            depth=self.depth,
            reliability=(
                ReliabilityPolicy.RELIABLE if self.reliable else ReliabilityPolicy.BEST_EFFORT
            ),
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if self.latched else DurabilityPolicy.VOLATILE
            ),
            **more,
        )

    def terms(self, node: str) -> Terms:
        """Return the policies as the other side sees them."""
        return Terms(node, self.reliable, self.latched, self.deadline, self.manual, self.lease)


def _offers(endpoint: Any) -> tuple[bool, bool]:
    profile = endpoint.qos_profile
    return profile.reliability.name == "RELIABLE", profile.durability.name == "TRANSIENT_LOCAL"


def for_subscription(publishers: Iterable[Any], wanted: Qos) -> Profile:
    """Match every publisher: best effort if any is, latched if all are, no deadline."""
    offers = [_offers(endpoint) for endpoint in publishers]
    reliable = bool(offers) and all(r for r, _ in offers)
    latched = bool(offers) and all(t for _, t in offers)
    return _override(wanted, Profile(reliable, latched))


def for_publisher(subscriptions: Iterable[Any], wanted: Qos) -> Profile:
    """Match every subscription: reliable suits all, other policies are offered as requested.

    A missed deadline or lease is reported to the subscriber that requested it, which is better than
    no match.
    """
    requested = [Terms.of(endpoint) for endpoint in subscriptions]
    matched = Profile(
        reliable=True,
        latched=any(request.latched for request in requested),
        deadline=min((request.deadline for request in requested), default=EVER),
        manual=any(request.manual for request in requested),
        lease=min((request.lease for request in requested), default=EVER),
    )
    return _override(wanted, matched)


def _override(wanted: Qos, matched: Profile) -> Profile:
    overrides: dict[str, Any] = {
        "reliable": _is(wanted.reliability, "reliable"),
        "latched": _is(wanted.durability, "transient_local"),
        "manual": _is(wanted.liveliness, "manual_by_topic"),
        "depth": 0 if wanted.history == "keep_all" else wanted.depth,
        "deadline": _ns(wanted.deadline),
        "lifespan": _ns(wanted.lifespan),
        "lease": _ns(wanted.lease),
    }
    return matched._replace(**{key: value for key, value in overrides.items() if value is not None})


def _is(policy: str | None, word: str) -> bool | None:
    return None if policy is None else policy == word


def _ns(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)


def clash(topic: str, ours: Profile, publishers: Iterable[Any]) -> str | None:
    """Describe the publishers that a subscription cannot receive; None if there are none."""
    requested = ours.terms("the gateway")
    lost = [words for offer in publishers for words in mismatches(Terms.of(offer), requested)]
    return f"{topic} is not received from every publisher: {'; '.join(lost)}" if lost else None


def unreached_subscribers(topic: str, ours: Profile, subscriptions: Iterable[Any]) -> str | None:
    """Describe the subscribers that a publisher cannot reach; None if there are none."""
    offered = ours.terms("the gateway")
    lost = [words for request in subscriptions for words in mismatches(offered, Terms.of(request))]
    return f"{topic} does not reach every subscriber: {'; '.join(lost)}" if lost else None


class Terms(NamedTuple):
    """The QoS that a publisher offers or a subscriber requests."""

    node: str
    reliable: bool
    latched: bool
    deadline: int = EVER
    """Maximum time between two messages, ns."""
    manual: bool = False
    """Whether the node has to assert its liveliness per topic."""
    lease: int = EVER
    """Liveliness lease duration, ns."""

    @classmethod
    def of(cls, endpoint: Any) -> Terms:
        """Return the policies of an endpoint of the graph."""
        profile = endpoint.qos_profile
        return cls(
            f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}",
            *_offers(endpoint),
            profile.deadline.nanoseconds or EVER,
            profile.liveliness.name == "MANUAL_BY_TOPIC",
            profile.liveliness_lease_duration.nanoseconds or EVER,
        )


def mismatches(offer: Terms, request: Terms) -> list[str]:
    """Describe why a subscriber receives nothing from a publisher, and how to fix it."""
    here, there = offer.node, request.node
    found: list[str] = []
    if request.reliable and not offer.reliable:
        found.append(
            f"{here} publishes best effort and {there} requests reliable "
            f"(let {here} publish reliable, or {there} request best effort)"
        )
    if request.latched and not offer.latched:
        found.append(
            f"{here} publishes volatile and {there} requests transient local "
            f"(let {here} publish transient local, or {there} request volatile)"
        )
    if offer.deadline > request.deadline:
        found.append(
            f"{there} requests a deadline of {request.deadline / 1e9:g} s and {here} offers "
            f"{_every(offer.deadline)} (set a deadline at least as short for {here}, or none for {there})"
        )
    if request.manual and not offer.manual:
        found.append(
            f"{there} requests liveliness by topic and {here} offers automatic "
            f"(let {here} offer it by topic, or {there} request automatic)"
        )
    if offer.lease > request.lease:
        found.append(
            f"{there} requests a liveliness lease of {request.lease / 1e9:g} s and {here} offers "
            f"{_every(offer.lease)} (set a lease at least as short for {here}, or none for {there})"
        )
    return found


def _every(span: int) -> str:
    return "none" if span >= EVER else f"{span / 1e9:g} s"
