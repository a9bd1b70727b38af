"""The change of a drive's id on its bus, refused if another one answers to the new id."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_can.procedure import Procedure
from rcp_kernel.errors import ModeForbids, OutOfRange, RcpError
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
    change: Callable[[Any, Callable[[], object]], Coroutine[Any, Any, None]],
    is_there: Callable[[int], Coroutine[Any, Any, bool]],
    *,
    input: type[NodeChange] = NodeChange,  # noqa: A002 - the field of a procedure
    note: str = "",
    also: Callable[[Any], None] | None = None,
) -> Procedure:
    """Return the procedure; `neighbours` are the motors of this kind on the bus, by node.

    `change` gives the drive the id, stores it, and returns when it answers to it; it calls what it
    gets once it may write. `is_there` asks whether anything answers to an id; `also` refuses what a
    make cannot take.
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
        if also is not None:
            also(wanted)

    async def run(wanted: NodeChange, _progress: Progress) -> NodeChanged:
        if wanted.node != current and await is_there(wanted.node):
            raise _taken(wanted.node, "a drive on this bus answers to it")
        begun = False

        def begin() -> None:
            nonlocal begun
            begun = True

        try:
            await change(wanted, begin)
        except RcpError as error:
            if begun:
                error.status = "failed" if error.status == "rejected" else error.status
                error.remedy = _remedy(current, wanted.node)
            raise
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


def _remedy(current: int, wanted: int) -> str:
    return (
        f"The drive may have the id {wanted} now, stored or until it is switched off. Switch it off "
        f"and on; if the motor is online then, it has {current} and you can send this again. "
        f"If not, set `node` to {wanted} and restart the gateway."
    )


def _taken(node: int, why: str) -> ModeForbids:
    return ModeForbids(
        f"the id {node} is taken: {why}",
        details={"pointer": "/node"},
        remedy="Nothing was written; choose another id, or change that of the other drive first.",
    )
