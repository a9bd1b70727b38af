"""The graphs that sessions see, built again when the tree has changed."""

from __future__ import annotations

from collections.abc import Generator
from weakref import WeakKeyDictionary

from rcp_gateway.api import Query, Rights, Session
from rcp_gateway.client_api import ClientApi
from rcp_rosbridge.graph import Facts, Graph

__all__ = ["Graphs"]

_PAGE = 500


class Graphs:
    """One graph for each combination of rights and tenant."""

    def __init__(self, client_api: ClientApi) -> None:
        self._client_api = client_api
        self._known: WeakKeyDictionary[Rights, dict[str | None, tuple[int, Graph]]] = (
            WeakKeyDictionary()
        )

    def ready(self, session: Session) -> Graph | None:
        """Return the graph if it has been built and the tree is the same."""
        found = self._known.get(session.rights, {}).get(session.tenant)
        if found is None or found[0] != self._client_api.generation(session):
            return None
        return found[1]

    def build(self, session: Session) -> Generator[None, None, Graph]:
        """Return the graph, in steps."""
        ready = self.ready(session)
        if ready is not None:
            return ready
        rights, tenant = session.rights, session.tenant
        generation = self._client_api.generation(session)
        resources: list[Facts] = []
        query: Query | None = Query(limit=_PAGE)
        complete = True
        pattern = "/tenant/**" if tenant is None else f"/tenant/{tenant}/**"
        while query is not None:
            page = yield from self._client_api.discover(session, pattern, query)
            for facts in page["resources"]:
                natives = self._client_api.native_types(session, facts["path"])
                texts = {
                    part: one.schema
                    for part, one in natives.items()
                    if one.schema_encoding == "ros2msg"
                }
                resources.append({**facts, "texts": texts})
            complete = complete and page.get("complete", True)
            cursor = page.get("cursor")
            query = None if cursor is None else Query(limit=_PAGE, cursor=cursor)
            yield
        graph = Graph(tenant, complete=complete)
        yield from graph.build(resources)
        self._known.setdefault(rights, {})[tenant] = (generation, graph)
        return graph
