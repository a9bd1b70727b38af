"""Types that are not installed, requested from nodes that have them."""

from __future__ import annotations

from typing import Any

from rcp_kernel.errors import RcpError
from rcp_ros2.caller import Caller
from rcp_ros2.definitions import define_described
from rcp_ros2.idl import load
from rcp_ros2.link import RosLink
from rcp_ros2.pulse import node_of

__all__ = ["learn"]

_TRIES = 3  # nodes queried
_PATIENCE = 2.0  # s for the response of a node


async def learn(link: RosLink, topic: str, type_: str) -> bool:
    """Request a type from the nodes on a topic; return whether one of them provided it.

    :raises MissingType: the type has a field of an unsupported type.
    """
    for node, digest in await link.ros.call(_nodes, link, topic):
        response = await _request_type(link, topic, node, type_, digest)
        if response is not None and response.successful:
            define_described(response.type_description, response.type_sources)
            return True
    return False


def _nodes(link: RosLink, topic: str) -> list[tuple[str, str]]:
    ros: Any = link.ros.node
    endpoints = [
        *ros.get_publishers_info_by_topic(topic),
        *ros.get_subscriptions_info_by_topic(topic),
    ]
    named = {node_of(endpoint): str(endpoint.topic_type_hash) for endpoint in endpoints}
    own = ros.get_fully_qualified_name()
    return [(node, digest) for node, digest in named.items() if node and node != own][:_TRIES]


async def _request_type(link: RosLink, topic: str, node: str, type_: str, digest: str) -> Any:
    srv = await link.ros.call(load, "type_description_interfaces/srv/GetTypeDescription")
    caller = Caller(link, srv, f"{node}/get_type_description", presence=("topic", topic))
    request = srv.Request(type_name=type_, type_hash=digest, include_type_sources=True)
    try:
        return await caller.call(request, _PATIENCE)
    except RcpError:  # a node without this service, or one that has disappeared
        return None
    finally:
        caller.close()
