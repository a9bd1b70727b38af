"""Discovery: the catalogue of visible resources, with schemas, examples, paging and search."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.access.acl import Rights, reach
from rcp_kernel.access.tree_views import TreeViews
from rcp_kernel.errors import BadRequest
from rcp_kernel.features.feature import Describe
from rcp_kernel.model import Kind, NativeType, Operation, Pattern, operation_names
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.values import ValueType, to_plain, value_type
from rcp_kernel.wire import Request
from rcp_requests.discovery_page import Description, DiscoveryPage
from rcp_requests.pages import LONGEST, MOST, cursor_of, place_of
from rcp_streams.frames import FrameConverter

__all__ = ["Discovery", "Query"]

_COMMANDED = Operation.WRITE | Operation.EXECUTE
_SCHEMAS = ("schema", "schemas")
_STEP = 32  # resources checked per step
_ALL = Pattern("/**")


class Query(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The body of `discover`; everything is optional."""

    kind: Kind | None = None
    op: Annotated[str, Meta(max_length=16)] | None = None
    q: Annotated[str, Meta(max_length=200)] | None = None
    """Words that must all occur in the path or the description."""
    profile: Annotated[str, Meta(max_length=100)] | None = None
    """A profile that they are part of: its name, alone or with as much of the version as matters."""
    limit: Annotated[int, Meta(ge=1, le=MOST)] = 100
    cursor: Annotated[str, Meta(max_length=LONGEST)] | None = None
    schemas: bool = True
    """Whether schemas are written out; their ids always are."""
    offers: bool = False
    """Whether operations that the caller may not use are listed too, apart from those it may."""


_QUERY = value_type(Query | None)


class Discovery:
    """Answers `discover` from the registry; descriptions are written once for each entry."""

    def __init__(
        self, registry: Registry, tree_views: TreeViews, describe: Describe, frames: FrameConverter
    ) -> None:
        self._registry = registry
        self._tree_views = tree_views
        self._describe = describe
        self._frames = frames
        self._known: dict[str, tuple[Entry, Description]] = {}
        registry.on_removed.append(self._forget)

    def _forget(self, entry: Entry) -> None:
        self._known.pop(entry.path, None)

    def generation(self, rights: Rights) -> int:
        """Return a number that increases only when the visible tree changes.

        After a change of thousands of resources it increases slightly later than the tree changes.
        """
        return self._tree_views.look(rights).number

    def answer(
        self,
        rights: Rights,
        tenant: str | None,
        request: Request,
        page: DiscoveryPage,
        longest: int,
    ) -> Generator[None]:
        """Carry out a `discover` request in steps: fill a page with at most `longest` bytes.

        :raises InvalidPath: the pattern is none.
        :raises BadRequest: the cursor or operation is none.
        """
        query: Query = request.decode_body(_QUERY, "discover") or Query()
        text = request.path
        if text is None:
            text = "/**" if tenant is None else f"/tenant/{tenant}/**"
        last, pattern = "", Pattern(text, tenant)
        # Ahead of the page: what changes meanwhile is news to whoever has this number.
        page.generation = (yield from self._tree_views.catch_up(rights)).number
        page.complete = not self._tree_views.growing(rights, pattern)
        for entry, mask in self._visited(rights, pattern, query):
            if mask:
                facts = self._facts(rights, entry, mask, query)
                leave = () if query.schemas else _SCHEMAS
                full = len(page) == query.limit
                if full or not page.add(self._description(entry), leave, facts, longest):
                    page.cursor = cursor_of(last)
                    break
                last = entry.path
            yield

    def find(
        self, rights: Rights, pattern: Pattern, query: Query
    ) -> Generator[None, None, dict[str, Any]]:
        """List in steps what matches and may be seen, one page of it."""
        page: list[dict[str, Any]] = []
        generation = self.generation(rights)
        whole: dict[str, Any] = (
            {"complete": False} if self._tree_views.growing(rights, pattern) else {}
        )
        for number, (entry, mask) in enumerate(self._visited(rights, pattern, query), 1):
            if not number % _STEP:
                yield
            if not mask:
                continue
            if len(page) == query.limit:
                whole["cursor"] = cursor_of(page[-1]["path"])
                break
            facts = self._facts(rights, entry, mask, query)
            page.append(self._described(entry, schemas=query.schemas) | facts)
        return {"resources": page, "generation": generation, **whole}

    def _visited(
        self, rights: Rights, pattern: Pattern, query: Query
    ) -> Iterator[tuple[Entry, int]]:
        """Iterate over the matches of a pattern with visible operations: 0 if not wanted."""
        wanted = _operation(query.op)
        words = query.q.casefold().split() if query.q else []
        after = place_of(query.cursor) if query.cursor else ""
        for entry in self._registry.match(pattern, after):
            mask = reach(rights.mask(entry.path))
            if (
                (query.kind is not None and entry.kind is not query.kind)
                or (wanted and not entry.operations & mask & wanted)
                or (words and not _has(entry, words))
                or (query.profile is not None and not _is_part(entry, query.profile))
            ):
                mask = 0
            yield entry, mask

    def _facts(self, rights: Rights, entry: Entry, mask: int, query: Query) -> dict[str, Any]:
        facts: dict[str, Any] = {
            "operations": operation_names(Operation(entry.operations & mask)),
            "state": _state(entry),
        }
        if entry.operations & mask & _COMMANDED:
            facts |= self._describe(rights, entry, schemas=query.schemas)
        if query.offers:
            facts["offers"] = operation_names(entry.operations)
        if frames := self._frames.known(rights, entry):
            facts["frames"] = frames
            if query.schemas and entry.operations & mask & Operation.EXECUTE:
                own = facts.get("command_schema", entry.input_type.schema)
                if (wider := self._frames.command_schema(entry, frames, own)) is not None:
                    facts["command_schema"] = wider
        return facts

    def _description(self, entry: Entry) -> Description:
        known = self._known.get(entry.path)
        if known is None or known[0] is not entry:
            known = self._known[entry.path] = (entry, Description(_describe(entry)))
        return known[1]

    def _described(self, entry: Entry, *, schemas: bool) -> dict[str, Any]:
        facts = self._description(entry).facts
        return dict(facts) if schemas else {k: v for k, v in facts.items() if k not in _SCHEMAS}

    def native_types(self, rights: Rights, path: str) -> Mapping[str, NativeType]:
        """Return the serialised types of a resource, by the part that has it; empty if hidden."""
        entry = self._registry.entries.get(path)
        if entry is None or not entry.operations & reach(rights.mask(path)):
            return {}
        return entry.resource.native_types

    def schemas(self, rights: Rights) -> Generator[None, None, dict[str, dict[str, Any]]]:
        """Collect in steps every schema of the visible resources, by id."""
        found: dict[str, dict[str, Any]] = {}
        for number, entry in enumerate(self._registry.match(_ALL), 1):
            if rights.mask(entry.path):
                found |= {type_.schema_id: type_.schema for type_ in _types(entry).values()}
            if not number % _STEP:
                yield
        return found


def _operation(name: str | None) -> Operation:
    if name is None:
        return Operation.NONE
    try:
        return Operation[name.upper()]
    except KeyError:
        allowed = ", ".join(operation_names(Operation(31)))
        raise BadRequest(f"{name!r} is not an operation", remedy=f"Use one of {allowed}.") from None


def _has(entry: Entry, words: list[str]) -> bool:
    text = f"{entry.path} {entry.resource.description}".casefold()
    return all(word in text for word in words)


def _is_part(entry: Entry, profile: str) -> bool:
    more = "." if "/" in profile else "/"  # of the version
    return any(one == profile or one.startswith(profile + more) for one in entry.resource.profiles)


def _state(entry: Entry) -> str:
    if entry.unit.usable_backend is None:
        return "down"
    if entry.kind in (Kind.ACTION, Kind.SERVICE):
        return "ready"
    if entry.latest is None:
        return "never"
    return "stale" if entry.stale else "fresh"


def _types(entry: Entry) -> dict[str, ValueType]:
    if entry.kind not in (Kind.ACTION, Kind.SERVICE):
        return {"value": entry.value_type}
    parts = {
        "input": (entry.resource.input, entry.input_type),
        "output": (entry.resource.output, entry.output_type),
        "feedback": (entry.resource.feedback, entry.feedback_type),
    }
    return {name: type_ for name, (declared, type_) in parts.items() if declared is not None}


def _describe(entry: Entry) -> dict[str, Any]:
    resource = entry.resource
    types = _types(entry)
    facts: dict[str, Any] = {
        "path": entry.path,
        "kind": entry.kind.value,
        "operations": [],
        "description": resource.description,
        "schemas": {name: type_.schema for name, type_ in types.items()},
        "schema_ids": {name: type_.schema_id for name, type_ in types.items()},
        "examples": [to_plain(example) for example in resource.examples],
        "backend": entry.owner.name,
    }
    if "value" in types and (unit := types["value"].schema.get("unit")) is not None:
        facts["unit"] = unit
    names = ("deadline", "timeout", "policy", "max_age", "valid_for", "atomic", "native")
    facts |= {n: v for n in names if (v := getattr(resource, n)) is not None}
    if resource.moves is not None:
        facts["moves"] = resource.moves
    if resource.energises:
        facts["energises"] = True
    if resource.safe is not None:
        facts["safe"] = to_plain(resource.safe)
    if resource.meta:
        facts["meta"] = resource.meta
    if resource.profiles:
        facts["profiles"] = list(resource.profiles)
    return facts
