"""What sets up a Damiao: its registers as settings, and its two ids."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from rcp_can.node_change import NodeChange, NodeId, node_procedure
from rcp_can.procedure import Procedure
from rcp_can.profiles.damiao_registers import ESC_ID, MST_ID, NAMES, REGISTERS, pack, unpack
from rcp_can.settings import Setting, Settings
from rcp_can.settings_procedures import settings_procedures
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, OutOfRange

if TYPE_CHECKING:
    from rcp_can.status import Status

__all__ = ["NODES", "DamiaoNode", "DamiaoSettings", "damiao_procedures"]

NODES = range(1, 16)
_REGISTERS, _READ, _WRITE = 0x7FF, 0x33, 0x55
_MODES = 0x300  # bits of the identifier that select another control mode's set-point
_SHORT = 0.3  # s for one register of many
_STORES = 1.0  # s


class DamiaoNode(NodeChange, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The id to which it listens, and that of its responses."""

    reply_id: NodeId | None = None
    """`reply_id` of the motor's options; None leaves it."""


class _Drive(Protocol):
    """A drive with registers."""

    node: int
    status: Status
    neighbours: Mapping[int, str]

    async def access(
        self,
        command: int,
        register: int,
        value: int = 0,
        *,
        node: int | None = None,
        seconds: float = 1.0,
    ) -> int:
        """Access a register; return its raw value."""
        ...

    async def store(self, node: int | None = None) -> None:
        """Store all registers."""
        ...

    def scaled(self, register: int, value: float) -> None:
        """Note the full scale that a register has."""
        ...


class DamiaoSettings(Settings):
    """The registers of one drive."""

    saves = True
    known: Mapping[str, Setting] = {
        each.name: Setting(writable=False)
        if each.low is None
        else Setting(low=each.low, high=each.high)
        for each in REGISTERS.values()
    }

    def __init__(self, drive: _Drive) -> None:
        self._drive = drive

    async def read_all(self, tell: Callable[[float], object]) -> dict[str, str]:
        """Read all; a drive is silent about registers that it does not have."""
        found: dict[str, str] = {}
        for done, (name, number) in enumerate(NAMES.items(), 1):
            try:
                raw = await self._drive.access(_READ, number, seconds=_SHORT)
            except DeviceTimeout:
                if not found:
                    raise
                continue
            found[name] = f"{unpack(number, raw):.8g}"
            tell(done / len(NAMES))
        return found

    async def read(self, name: str) -> str:
        """Read one."""
        number = NAMES[name]
        value = unpack(number, await self._drive.access(_READ, number))
        self._drive.scaled(number, value)
        return f"{value:.8g}"

    async def write(self, name: str, value: str) -> None:
        """Write one."""
        number = NAMES[name]
        await self._drive.access(_WRITE, number, pack(number, value))

    async def save(self) -> None:
        """Store all."""
        await self._drive.store()


def damiao_procedures(
    drive: _Drive, is_there: Callable[[int], Coroutine[Any, Any, bool]]
) -> Sequence[Procedure]:
    """List the procedures of a Damiao."""

    async def change(wanted: DamiaoNode, begun: Callable[[], object]) -> None:
        node = drive.node
        begun()
        if wanted.node != drive.node:
            with suppress(DeviceTimeout):  # it may confirm by its new id already
                await drive.access(_WRITE, ESC_ID, wanted.node)
            node = await _answering(drive, (wanted.node, drive.node))
        if wanted.reply_id is not None:
            await drive.access(_WRITE, MST_ID, wanted.reply_id, node=node)
        await drive.store(node)
        for register, value in ((ESC_ID, wanted.node), (MST_ID, wanted.reply_id)):
            kept = await drive.access(_READ, register, node=wanted.node)
            if value not in (None, kept):
                name = REGISTERS[register].name
                raise DeviceRejected(f"the drive kept {name} {kept} instead of {value}")

    def check_reply(wanted: DamiaoNode) -> None:
        reply = wanted.reply_id
        if reply is None:
            return
        if reply == _REGISTERS or reply & ~_MODES in NODES or reply in drive.neighbours:
            raise OutOfRange(
                f"reply_id 0x{reply:X} is an identifier by which drives are commanded: they would "
                "take its responses for set-points",
                details={"pointer": "/reply_id"},
                remedy="Choose another, such as 0x10 and the id.",
            )

    return (
        *settings_procedures(DamiaoSettings(drive)),
        node_procedure(
            drive.node,
            NODES,
            drive.neighbours,
            change,
            is_there,
            input=DamiaoNode,
            note=" All other settings are stored with it.",
            also=check_reply,
        ),
    )


async def _answering(drive: _Drive, nodes: Sequence[int]) -> int:
    """Return to which id it answers: makers' tools do not say when a new one takes effect."""
    for node in nodes:
        try:
            await drive.access(_READ, ESC_ID, node=node, seconds=_SHORT)
        except DeviceTimeout:
            continue
        return node
    raise DeviceTimeout(
        f"the drive answers neither to {' nor to '.join(map(str, nodes))} after its id was written",
        remedy="Switch it off and on: what is not stored is forgotten.",
    )
