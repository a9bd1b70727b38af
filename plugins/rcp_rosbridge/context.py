"""What the parts of one client's connection share."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

import msgspec

from rcp_gateway.api import Connection, to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import RcpError
from rcp_kernel.wire import Reply, Request
from rcp_rosbridge.config import RosbridgeConfig
from rcp_rosbridge.dialects import Renderings
from rcp_rosbridge.fragments import split
from rcp_rosbridge.graph import Graph
from rcp_rosbridge.graphs import Graphs
from rcp_rosbridge.png import to_png
from rcp_rosbridge.status import StatusMessages

__all__ = ["Context", "Packing"]


class Packing(msgspec.Struct, frozen=True):
    """How a client wants one kind of messages packed."""

    fragment: int | None = None
    """Longest message in one piece."""
    png: bool = False

    @property
    def plain(self) -> bool:
        """Whether messages are sent as they are."""
        return self.fragment is None and not self.png

    def pack(self, message: bytes) -> list[bytes]:
        """Return the messages to send for one."""
        if self.png:
            message = to_png(message)
        return [message] if self.fragment is None else split(message, self.fragment)


@dataclass(slots=True)
class Context:
    """One client's connection to the gateway, and what its operations need."""

    client_api: ClientApi
    config: RosbridgeConfig
    connection: Connection
    graphs: Graphs
    renderings: Renderings
    status: StatusMessages

    @property
    def owner(self) -> object:
        """In whose turns work is done."""
        return self.connection.session.principal.identity

    def send(self, message: object, packing: Packing | None = None) -> bool:
        """Queue a message; return False if too much is unread."""
        data = message if isinstance(message, bytes) else msgspec.json.encode(message)
        outbox = self.connection.outbox
        if self.connection.closed or outbox.backlog.refuses(len(data)):
            return False
        for part in [data] if packing is None else packing.pack(data):
            outbox.put(part)
        return True

    def request(self, request: Request, answer: Callable[[Reply], None]) -> None:
        """Send a request of the client."""
        self.client_api.submit(self.connection.session, request, answer)

    def with_graph(self, use: Callable[[Graph], None], failed: Callable[[RcpError], None]) -> None:
        """Call `use` with the graph that the client may see: now if it is known."""
        graph = self.graphs.ready(self.connection.session)
        if graph is not None:
            _contained(use, graph, failed)
            return
        try:
            self.client_api.charge(self.connection.session)
            self.client_api.turns.run(self.owner, self._build(use, failed))
        except RcpError as error:
            failed(error)

    def _build(
        self, use: Callable[[Graph], None], failed: Callable[[RcpError], None]
    ) -> Generator[None]:
        try:
            graph = yield from self.graphs.build(self.connection.session)
        except Exception as error:
            failed(to_internal_error(error))
            return
        if not self.connection.closed:
            _contained(use, graph, failed)


def _contained(
    use: Callable[[Graph], None], graph: Graph, failed: Callable[[RcpError], None]
) -> None:
    """Use a graph; whatever fails is told, so that nobody waits for ever."""
    try:
        use(graph)
    except Exception as error:
        failed(to_internal_error(error))
