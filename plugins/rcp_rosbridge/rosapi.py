"""The rosapi services: what exists, of which types, and parameters."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest, UnknownPath
from rcp_kernel.values import to_plain
from rcp_kernel.wire import Body, Reply, Request
from rcp_ros_messages import full_name, time_of
from rcp_ros_messages.definitions import SERVICES
from rcp_ros_messages.message_type import parse
from rcp_rosbridge.compatibility import decoded
from rcp_rosbridge.context import Context
from rcp_rosbridge.graph import Graph, RosTopic, same_type
from rcp_rosbridge.typedefs import Typedef, text_of, typedefs, typedefs_of_schema, typedefs_of_text

__all__ = ["NAMES", "Rosapi"]

Respond = Callable[[Any, bool], None]
Args = dict[str, Any]
_DISTRIBUTION = "rcp"


class Rosapi:
    """Answers from the graph that the client may see."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def call(self, name: str, args: msgspec.Raw, graph: Graph, respond: Respond) -> None:
        """Call one of the services.

        :raises RcpError: there is none of that name, or an argument is wrong.
        """
        found = decoded(args) if args else {}
        if isinstance(found, list):
            names = _ARGUMENTS.get(name, ())
            found = dict(zip(names, found, strict=False))  # pyright: ignore[reportUnknownArgumentType,reportUnknownVariableType]
        if not isinstance(found, dict):
            raise BadRequest("the arguments of a rosapi service are an object")
        if name in _PARAMETERS:
            self._parameter(name, found, graph, respond)  # pyright: ignore[reportUnknownArgumentType]
            return
        answer = _ANSWERS.get(name)
        if answer is None:
            raise UnknownPath(
                f"there is no service /rosapi/{name[:64]}",
                remedy=f"There are {', '.join(NAMES)}.",
            )
        respond(answer(graph, found), True)

    # -- parameters ----------------------------------------------------------------------------

    def _parameter(self, name: str, args: Args, graph: Graph, respond: Respond) -> None:
        wanted = _text(args, "name")
        found = graph.parameters.get(wanted) or graph.parameters.get(wanted.replace("/", "", 1))
        if found is None and ":" not in wanted:
            found = next((p for n, p in graph.parameters.items() if n.endswith(f":{wanted}")), None)
        if name == "has_param":
            respond({"exists": found is not None, "successful": True, "reason": ""}, True)
            return
        if name == "delete_param":
            reason = "parameters of robots cannot be deleted"
            respond({"successful": False, "reason": reason}, True)
            return
        if found is None:
            default = str(args.get("default_value") or "") if name == "get_param" else None
            values: Args = {"successful": False, "reason": f"there is no parameter {wanted}"}
            respond(values if default is None else {"value": default, **values}, True)
            return
        body = msgspec.Raw()
        if name == "set_param":
            body = msgspec.Raw(_as_json(_text(args, "value")))
        type_ = "read" if name == "get_param" else "write"

        def answer(reply: Reply) -> None:
            if not reply.final:
                return
            error = reply.error
            values: Args = {
                "successful": error is None,
                "reason": error["message"] if error else "",
            }
            if name == "get_param":
                value = "" if error else msgspec.json.encode(_plain(reply.body)).decode()
                values["value"] = value
            respond(values, True)

        self._context.request(Request(type=type_, path=found.path, body=body), answer)


def _plain(body: Any) -> Any:
    return to_plain(body.value if isinstance(body, Body) else body)


def _as_json(text: str) -> bytes:
    """Return a value of `set_param`, which is JSON, or text that its sender has not encoded."""
    try:
        msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError):
        return msgspec.json.encode(text)
    return text.encode()


def _text(args: Args, name: str) -> str:
    value = args.get(name, "")
    if not isinstance(value, str):
        raise BadRequest(f"`{name}` is text")
    return value


def _named(args: Args, name: str, known: dict[str, Any]) -> Any:
    """Return the item that an argument names; None if there is none."""
    wanted = _text(args, name)
    return known.get(wanted if wanted.startswith("/") else f"/{wanted}")


# -- topics ------------------------------------------------------------------------------------


def _topics(graph: Graph, _: Args) -> Any:
    names = sorted(graph.topics)
    return {"topics": names, "types": [graph.topics[name].type for name in names]}


def _topics_and_raw_types(graph: Graph, args: Args) -> Any:
    texts = [t.text or text_of(t.type, t.schema) for _, t in sorted(graph.topics.items())]
    return {**_topics(graph, args), "typedefs_full_text": texts}


def _topics_for_type(graph: Graph, args: Args) -> Any:
    wanted = _text(args, "type")
    return {"topics": sorted(n for n, t in graph.topics.items() if same_type(t.type, wanted))}


def _interfaces(graph: Graph, _: Args) -> Any:
    types = {t.type for t in graph.topics.values()} | {s.type for s in graph.services.values()}
    return {"interfaces": sorted(types | {a.type for a in graph.actions.values()})}


def _topic_type(graph: Graph, args: Args) -> Any:
    topic: RosTopic | None = graph.topic(_text(args, "topic"))
    return {"type": topic.type if topic is not None else ""}


def _publishers(graph: Graph, args: Args) -> Any:
    topic = graph.topic(_text(args, "topic"))
    return {"publishers": topic.publishers if topic is not None else []}


def _subscribers(graph: Graph, args: Args) -> Any:
    topic = graph.topic(_text(args, "topic"))
    return {"subscribers": topic.subscribers if topic is not None else []}


# -- services, actions, nodes ------------------------------------------------------------------


def _services(graph: Graph, _: Args) -> Any:
    return {"services": sorted([*graph.services, *(f"/rosapi/{name}" for name in NAMES)])}


def _services_for_type(graph: Graph, args: Args) -> Any:
    wanted = _text(args, "type")
    return {"services": sorted(n for n, s in graph.services.items() if s.type == wanted)}


def _service_type(graph: Graph, args: Args) -> Any:
    wanted = _text(args, "service")
    name = wanted.removeprefix("/rosapi/")
    if name in NAMES and name != wanted:
        return {"type": f"rosapi_msgs/srv/{''.join(word.title() for word in name.split('_'))}"}
    service = graph.service(wanted)
    return {"type": service.type if service is not None else ""}


def _service_node(graph: Graph, args: Args) -> Any:
    service = graph.service(_text(args, "service"))
    return {"node": service.node if service is not None else ""}


def _service_providers(graph: Graph, args: Args) -> Any:
    wanted = _text(args, "service")
    nodes = {s.node for s in graph.services.values() if wanted in (s.type, s.name)}
    return {"providers": sorted(nodes)}


def _action_servers(graph: Graph, _: Args) -> Any:
    return {"action_servers": sorted(graph.actions)}


def _action_type(graph: Graph, args: Args) -> Any:
    action = graph.action(_text(args, "action"))
    return {"type": action.type if action is not None else ""}


def _nodes(graph: Graph, _: Args) -> Any:
    return {"nodes": sorted(graph.nodes)}


def _node_details(graph: Graph, args: Args) -> Any:
    node = _text(args, "node")
    return {
        "publishing": sorted(n for n, t in graph.topics.items() if node in t.publishers),
        "subscribing": sorted(n for n, t in graph.topics.items() if node in t.subscribers),
        "services": sorted(n for n, s in graph.services.items() if s.node == node),
    }


# -- types -------------------------------------------------------------------------------------


def _message_details(graph: Graph, args: Args) -> Any:
    name = full_name(_text(args, "type"))
    found = typedefs(name)
    if not found:
        topic = next((t for t in graph.topics.values() if full_name(t.type) == name), None)
        if topic is None:
            raise UnknownPath(f"the type {name} is not known")
        found = _described(name, topic.text, topic.schema)
    return {"typedefs": found}


def _described(name: str, text: str | None, schema: dict[str, Any]) -> list[Typedef]:
    """Describe a type by its definition, which has the widths of numbers, or else by its schema."""
    if text is not None:
        try:
            return typedefs_of_text(name, text)
        except ValueError:  # written in a way that is not known
            pass
    return typedefs_of_schema(name, schema)


def _details(graph: Graph, args: Args, part: int) -> Any:
    name = _text(args, "type")
    half = "_Request" if part == 0 else "_Response"
    if name in SERVICES:
        type_ = parse(name + half, SERVICES[name][part])
        return {"typedefs": [_flat(type_.name, [(f.name, f.type) for f in type_.fields])]}
    service = next((s for s in graph.services.values() if s.type == name), None)
    if service is None:
        raise UnknownPath(f"the type {name} is not known")
    schema = service.input if part == 0 else service.output
    if schema is None:
        return {"typedefs": [_flat(name + half, [])]}
    text = service.texts.get("input" if part == 0 else "output")
    return {"typedefs": _described(name + half, text, schema)}


def _flat(name: str, fields: list[tuple[str, str]]) -> Typedef:
    return {
        "type": name,
        "fieldnames": [field for field, _ in fields],
        "fieldtypes": [type_ for _, type_ in fields],
        "fieldarraylen": [-1 for _ in fields],
        "examples": ["" for _ in fields],
        "constnames": [],
        "constvalues": [],
    }


def _action_details(part: str) -> Callable[[Graph, Args], Any]:
    def details(graph: Graph, args: Args) -> Any:
        name = _text(args, "type")
        action = next((a for a in graph.actions.values() if a.type == name), None)
        if action is None:
            raise UnknownPath(f"the type {name} is not known")
        schema = action.schemas.get({"Goal": "input", "Result": "output"}.get(part, "feedback"))
        return {"typedefs": typedefs_of_schema(f"{name}_{part}", schema or {"properties": {}})}

    return details


def _get_time(_: Graph, _args: Args) -> Any:
    now = time_of(time.time_ns())
    # Older clients know the fields by the names of ROS 1.
    return {"time": {**now, "secs": now["sec"], "nsecs": now["nanosec"]}}


_ANSWERS: dict[str, Callable[[Graph, Args], Any]] = {
    "topics": _topics,
    "interfaces": _interfaces,
    "topics_for_type": _topics_for_type,
    "topics_and_raw_types": _topics_and_raw_types,
    "get_topics_and_raw_types": _topics_and_raw_types,
    "topic_type": _topic_type,
    "publishers": _publishers,
    "subscribers": _subscribers,
    "services": _services,
    "services_for_type": _services_for_type,
    "service_type": _service_type,
    "service_node": _service_node,
    "service_providers": _service_providers,
    "service_host": lambda _graph, _args: {"host": ""},
    "action_servers": _action_servers,
    "action_type": _action_type,
    "nodes": _nodes,
    "node_details": _node_details,
    "message_details": _message_details,
    "service_request_details": lambda graph, args: _details(graph, args, 0),
    "service_response_details": lambda graph, args: _details(graph, args, 1),
    "action_goal_details": _action_details("Goal"),
    "action_result_details": _action_details("Result"),
    "action_feedback_details": _action_details("Feedback"),
    "get_param_names": lambda graph, _: {"names": sorted(graph.parameters)},
    "get_time": _get_time,
    "get_ros_version": lambda _graph, _args: {"version": 2, "distro": _DISTRIBUTION},
}
_PARAMETERS = ("get_param", "set_param", "has_param", "delete_param")
NAMES = (*_ANSWERS, *_PARAMETERS)
_ARGUMENTS = {
    "topics_for_type": ("type",),
    "topic_type": ("topic",),
    "publishers": ("topic",),
    "subscribers": ("topic",),
    "services_for_type": ("type",),
    "service_type": ("service",),
    "node_details": ("node",),
    "message_details": ("type",),
    "service_request_details": ("type",),
    "service_response_details": ("type",),
    "get_param": ("name", "default_value"),
    "set_param": ("name", "value"),
    "has_param": ("name",),
    "delete_param": ("name",),
}
"""Arguments of calls whose arguments are a list, in their order."""
