"""Types that are not installed: requested from nodes that have them, or from their texts.

A node describes a type to whoever knows its hash. The graph has the hashes of messages: those of
topics, and those of the requests and responses of services, by which a text is verified.
"""

from __future__ import annotations

import asyncio
import importlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

import structlog

from rcp_kernel.errors import RcpError
from rcp_ros2.caller import Caller
from rcp_ros2.definitions import BadText, define_described, define_text
from rcp_ros2.graph import CALLS
from rcp_ros2.idl import MissingType, fields_of, is_known, load
from rcp_ros2.link import RosLink
from rcp_ros2.made import define_action, define_service
from rcp_ros2.pulse import node_of
from rcp_ros2.support import type_hash
from rcp_ros2.texts import Texts

__all__ = ["Learning", "is_installed"]

log = structlog.get_logger("rcp.ros2")
_TRIES = 3  # nodes queried
_PATIENCE = 2.0  # s for the response of a node
_HASH = "RIHS01_"
_NONE = f"{_HASH}{'0' * 64}"
_MATCH = 1.0  # s for a server that the graph lists to be discovered in full
_PAUSE = 0.05  # s
_PARTS = {
    "service": {"Request": "rq{}Request", "Response": "rr{}Reply"},
    "action": {
        "SendGoal_Request": "rq{}/_action/send_goalRequest",
        "GetResult_Response": "rr{}/_action/get_resultReply",
        "FeedbackMessage": "{}/_action/feedback",
    },
}
"""The topics of a server that have the hash of a message of its type."""


class Learning:
    """Defines types that are not installed."""

    def __init__(self, link: RosLink, texts: Texts) -> None:
        self._link = link
        self._texts = texts

    async def topic(self, topic: str, type_: str) -> bool:
        """Request a type from the nodes on a topic; return whether one of them provided it.

        :raises MissingType: the type has a field of an unsupported type.
        """
        for node, digest in await self._link.ros.call(self._nodes, topic):
            response = await self._request_type(topic, node, type_, digest)
            if response is None or not response.successful:
                continue
            if response.type_description.type_description.type_name == type_:
                define_described(response.type_description, response.type_sources)
                return True
        return False

    async def interface(self, noun: str, name: str, type_: str) -> bool:
        """Define the type of a service or action that its server has; return whether it is known.

        :raises MissingType: its texts are of other versions.
        """
        hashes = await self._server(noun, name, type_)
        if is_known(type_) and not await self._link.ros.call(_differences, hashes):
            return True
        found = False
        for text in self._texts.of(type_, hashed=bool(hashes)):
            found = True
            try:
                define_text(type_, text)
                wrong = await self._link.ros.call(_differences, hashes)
            except BadText as error:
                log.warning("ros_text_wrong", type=type_, detail=str(error))
                continue
            if noun == "action" and wrong == {f"{type_}_FeedbackMessage"}:
                wrong = await self._learn_feedback(name, type_, wrong)
            if not wrong:
                return True
        if noun == "service" and await self._learn_calls(name, type_):
            return True
        if found:
            server = f"the server of {name} has another version of it than the known texts"
            raise MissingType(type_, server)
        return False

    async def _learn_feedback(self, name: str, type_: str, wrong: set[str]) -> set[str]:
        """Take the feedback as the server describes it."""
        if not await self.topic(f"{name}/_action/feedback", f"{type_}_FeedbackMessage"):
            return wrong
        await self._link.ros.call(define_action, type_)
        return set()

    async def _learn_calls(self, name: str, type_: str) -> bool:
        """Take a service as its node describes the topic of its calls, if that is enabled."""
        if not self._link.graph.publishers.get(f"{name}{CALLS}"):
            return False
        if not await self.topic(f"{name}{CALLS}", f"{type_}_Event"):
            return False
        define_service(type_)
        return True

    def _nodes(self, topic: str) -> list[tuple[str, str]]:
        ros: Any = self._link.ros.node
        endpoints = [
            *ros.get_publishers_info_by_topic(topic),
            *ros.get_subscriptions_info_by_topic(topic),
        ]
        named = {node_of(endpoint): str(endpoint.topic_type_hash) for endpoint in endpoints}
        own = ros.get_fully_qualified_name()
        return [(node, digest) for node, digest in named.items() if node and node != own][:_TRIES]

    async def _request_type(self, topic: str, node: str, type_: str, digest: str) -> Any:
        link = self._link
        srv = await link.ros.call(load, "type_description_interfaces/srv/GetTypeDescription")
        caller = Caller(link, srv, f"{node}/get_type_description", presence=("topic", topic))
        request = srv.Request(type_name=type_, type_hash=digest, include_type_sources=True)
        try:
            return await caller.call(request, _PATIENCE)
        except RcpError:  # a node without this service, or one that has disappeared
            return None
        finally:
            caller.close()

    async def _server(self, noun: str, name: str, type_: str) -> dict[str, str]:
        """Return the hashes of the messages that the server has; none before Iron."""
        end = time.monotonic() + _MATCH
        while True:
            found = dict(
                await self._link.ros.call(
                    lambda: list(_hashes(self._link.ros.node, noun, name, type_))
                )
            )
            if len(found) == len(_PARTS[noun]) or time.monotonic() >= end:
                return found
            await asyncio.sleep(_PAUSE)


def is_installed(type_: str, group: str) -> bool:
    """Return whether a type has compiled code."""
    package, *_, leaf = type_.split("/")
    try:
        return hasattr(importlib.import_module(f"{package}.{group}"), leaf)
    except ImportError:
        return False


def _hashes(node: Any, noun: str, name: str, type_: str) -> Iterator[tuple[str, str]]:
    """Yield the messages of a server with their hashes; services are topics of the middleware."""
    for ending, topic in _PARTS[noun].items():
        published = not topic.startswith("rq")
        find = (
            node.get_publishers_info_by_topic if published else node.get_subscriptions_info_by_topic
        )
        for endpoint in find(topic.format(name), no_mangle=topic.startswith("r")):
            digest = str(endpoint.topic_type_hash)
            if digest.startswith(_HASH) and digest != _NONE:
                yield f"{type_}_{ending}", digest


def _differences(hashes: Mapping[str, str]) -> set[str]:
    """Return the messages whose defined types have other hashes; called in the ROS thread."""
    return {
        name
        for name, digest in hashes.items()
        if digest != f"{_HASH}{type_hash(name, fields_of(load(name))).hex()}"
    }
