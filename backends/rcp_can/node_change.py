"""The change of a drive's id on its bus, refused if another one answers to the new id."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_can.procedure import Procedure
from rcp_kernel.errors import ModeForbids, OutOfRange
from rcp_kernel.spi import Progress

__all__ = ["NodeChange", "NodeChanged", "node_procedure"]

_TIMEOUT = 20.0  # s

NodeId = Annotated[int, Meta(ge=0, le=0x7FF, extra_json_schema={"unit": "1"})]


class NodeChange(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The id that the drive is to have."""

    node: NodeId


class NodeChanged(Struct, frozen=True, kw_only=True):
    """The id to which the drive answers now, stored; set it as `node` of the motor, and restart."""

    node: NodeId


def node_procedure(
    current: int,
    nodes: range,
    neighbours: Mapping[int, str],
    change: Callable[[Any], Coroutine[Any, Any, None]],
    is_there: Callable[[int], Coroutine[Any, Any, bool]],
    *,
    input: type[NodeChange] = NodeChange,  # noqa: A002 - the field of a procedure
    note: str = "",
) -> Procedure:
    """Return the procedure; `neighbours` are the motors of this kind on the bus, by node.

    `change` gives the drive the id, stores it, and returns when it answers to it; `is_there` asks
    whether anything answers to an id.
    """

    def check(wanted: NodeChange) -> None:
        node = wanted.node
        if node not in nodes:
            raise OutOfRange(
                f"the id is {nodes.start} to {nodes.stop - 1}, not {node}",
                details={"pointer": "/node"},
            )
        if (other := neighbours.get(node)) is not None and node != current:
            raise _taken(node, f"it is that of motor '{other}'")

    async def run(wanted: NodeChange, _progress: Progress) -> NodeChanged:
        if wanted.node != current and await is_there(wanted.node):
            raise _taken(wanted.node, "a drive on this bus answers to it")
        await change(wanted)
        return NodeChanged(node=wanted.node)

    return Procedure(
        "set_node",
        "Give it another id, stored; refused if another drive answers to it. It is reached again "
        f"once `node` of the motor is that id.{note}",
        run,
        needs="disabled",
        input=input,
        output=NodeChanged,
        examples=({"node": nodes.start + 1},),
        timeout=_TIMEOUT,
        check=check,
    )


def _taken(node: int, why: str) -> ModeForbids:
    return ModeForbids(
        f"the id {node} is taken: {why}",
        details={"pointer": "/node"},
        remedy="Nothing was written; choose another id, or change that of the other drive first.",
    )
