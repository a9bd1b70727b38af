"""Compatibility of JSON Schemas: what a new one still accepts, and what it may return.

`unaccepted` is for values that a client sends, `unexpected` for values it receives. Both return
sentences that start with the place in the value; none means compatible.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

__all__ = ["unaccepted", "unexpected"]

_LOWER = ("minimum", "exclusiveMinimum", "minLength", "minItems")
_UPPER = ("maximum", "exclusiveMaximum", "maxLength", "maxItems")
_TEXT = ("pattern", "format")
_RANGES = (("minimum", "maximum"), ("minLength", "maxLength"), ("minItems", "maxItems"))


class _Node(NamedTuple):
    """A schema, and the document in which its references are resolved."""

    schema: Any
    root: dict[str, Any]

    def at(self, schema: Any) -> _Node:
        return _Node(schema, self.root)


def unaccepted(old: dict[str, Any], new: dict[str, Any], *, limits: bool = False) -> list[str]:
    """List the values of `old` that `new` does not accept.

    With `limits`, `new` may have additional bounds on numbers and lengths, and on its enum values
    or keys.
    """
    return list(_Accepts(limits=limits).compare(_Node(old, old), _Node(new, new), ""))


def unexpected(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """List the values of `new` that `old` did not announce; additional fields are allowed."""
    return list(_Yields().compare(_Node(old, old), _Node(new, new), ""))


def _alternatives(node: _Node) -> list[_Node]:
    """Resolve references and unions to schemas of one type each."""
    schema = node.schema
    if schema is False:
        return []
    found: dict[str, Any] = {} if schema is True else schema
    if "$ref" in found:
        target: Any = node.root
        for step in str(found["$ref"]).removeprefix("#/").split("/"):
            target = target[step]
        return _alternatives(node.at(target))
    if "anyOf" in found:
        rest = {key: found[key] for key in ("unit",) if key in found}
        return [
            one.at({**rest, **one.schema}) if rest else one
            for option in found["anyOf"]
            for one in _alternatives(node.at(option))
        ]
    return [node.at(found)]


def _type(node: _Node) -> str:
    schema = node.schema
    if "type" in schema:
        return schema["type"]
    words = schema.get("enum", [schema["const"]] if "const" in schema else None)
    if words is None:
        return "any"
    return "string" if all(isinstance(word, str) for word in words) else "enum"


def _words(node: _Node) -> set[Any] | None:
    schema = node.schema
    if "enum" in schema:
        return set(schema["enum"])
    return {schema["const"]} if "const" in schema else None


def _unit(node: _Node) -> str | None:
    return node.schema.get("unit")


def _where(place: str) -> str:
    return place or "the value"


class _Comparison:
    """The common part of both directions."""

    def __init__(self) -> None:
        self._entered: set[tuple[int, int]] = set()
        """The pairs of objects being compared, which types that contain themselves come back to."""

    def _once(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        pair = id(old.schema), id(new.schema)
        if pair in self._entered:
            return
        self._entered.add(pair)
        try:
            yield from self._object(old, new, place)
        finally:
            self._entered.discard(pair)

    def _object(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        raise NotImplementedError

    def compare(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        """Yield the reasons against `new` in place of `old`."""
        raise NotImplementedError

    def _units(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        if _unit(old) != _unit(new):
            yield f"{_where(place)} is in {_unit(new) or 'no unit'}, not in {_unit(old) or 'none'}"
        if old.schema.get("contentEncoding") != new.schema.get("contentEncoding"):
            yield f"{_where(place)} is {'text' if 'contentEncoding' in old.schema else 'bytes'}"


class _Accepts(_Comparison):
    """A client continues to send values of the old schema."""

    def __init__(self, *, limits: bool) -> None:
        super().__init__()
        self._limits = limits

    def compare(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        """Yield which values of `old` are not values of `new`."""
        options = _alternatives(new)
        if any(_type(option) == "any" for option in options):
            return
        for one in _alternatives(old):
            yield from self._one(one, options, place)

    def _one(self, old: _Node, options: list[_Node], place: str) -> Iterator[str]:
        kind = _type(old)
        takers = [o for o in options if _type(o) == kind]
        if kind == "integer":
            takers += [o for o in options if _type(o) == "number"]
        if not takers:
            yield f"{_where(place)} takes no {kind}"
            return
        found = [list(self._same_type(old, taker, place)) for taker in takers]
        yield from min(found, key=len)

    def _same_type(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        yield from self._units(old, new, place)
        match _type(old):
            case "object":
                yield from self._once(old, new, place)
            case "array":
                yield from self._array(old, new, place)
            case _:
                pass
        known, taken = _words(old), _words(new)
        if self._limits:
            yield from _disjoint(old, new, place)
            refused = known is not None and taken is not None and not known & taken
        else:
            yield from _narrowed(old, new, place)
            refused = taken is not None and (known is None or bool(known - taken))
        if refused and taken is not None:
            yield f"{_where(place)} takes only {_listed(taken)}"

    def _object(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        mine: dict[str, Any] = old.schema.get("properties", {})
        theirs: dict[str, Any] = new.schema.get("properties", {})
        rest = new.schema.get("additionalProperties", True)
        for name, schema in mine.items():
            inner = f"{place}/{name}"
            if name in theirs:
                yield from self.compare(old.at(schema), new.at(theirs[name]), inner)
                yield from _defaulted(schema, theirs[name], inner)
            elif rest is False:
                yield f"{inner} is not taken"
            else:
                yield from self.compare(old.at(schema), new.at(rest), inner)
        for name in new.schema.get("required", ()):
            if name not in old.schema.get("required", ()):
                yield f"{place}/{name} is required"
        keyed = old.schema.get("additionalProperties", True)
        if mine and keyed is not False and rest is False and not self._limits:
            yield f"{_where(place)} does not take further fields"
        if mine or keyed is False:
            return
        yield from self._map(old.at(keyed), new, place)

    def _map(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        """Compare a map of any keys with another one, or with an object of known keys."""
        theirs: dict[str, Any] = new.schema.get("properties", {})
        rest = new.schema.get("additionalProperties", True)
        if rest is False and not self._limits:
            yield f"{_where(place)} does not take every key"
        for name, schema in theirs.items():
            yield from self.compare(old, new.at(schema), f"{place}/{name}")
        if rest is not False:
            yield from self.compare(old, new.at(rest), f"{place}/*")

    def _array(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        for mine, theirs in _items(old, new):
            yield from self.compare(mine, theirs, f"{place}/*")


class _Yields(_Comparison):
    """A client continues to read by the old schema."""

    def compare(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        """Yield which values of `new` are not values of `old`."""
        options = _alternatives(old)
        if any(_type(option) == "any" for option in options):
            return
        for one in _alternatives(new):
            kind = _type(one)
            known = [o for o in options if _type(o) == kind]
            if kind == "integer":
                known += [o for o in options if _type(o) == "number"]
            if not known:
                yield f"{_where(place)} may be {kind}"
                continue
            yield from min((list(self._same_type(o, one, place)) for o in known), key=len)

    def _same_type(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        yield from self._units(old, new, place)
        yield from _narrowed(new, old, place, "may be beyond")
        known, given = _words(old), _words(new)
        if known is not None and (given is None or given - known):
            more = "any text" if given is None else _listed(given - known)
            yield f"{_where(place)} may be {more}"
        match _type(old):
            case "object":
                yield from self._once(old, new, place)
            case "array":
                for mine, theirs in _items(old, new):
                    yield from self.compare(mine, theirs, f"{place}/*")
            case _:
                pass

    def _object(self, old: _Node, new: _Node, place: str) -> Iterator[str]:
        mine: dict[str, Any] = old.schema.get("properties", {})
        theirs: dict[str, Any] = new.schema.get("properties", {})
        for name, schema in mine.items():
            inner = f"{place}/{name}"
            if name in theirs:
                yield from self.compare(old.at(schema), new.at(theirs[name]), inner)
                if name in old.schema.get("required", ()) and _may_be_missing(new, name):
                    yield f"{inner} may be missing"
            elif name in old.schema.get("required", ()) or _is_always_there(schema):
                yield f"{inner} is missing"
        keyed = old.schema.get("additionalProperties", True)
        if mine or keyed in (True, False):
            return
        rest = new.schema.get("additionalProperties", True)
        for name, schema in theirs.items():
            yield from self.compare(old.at(keyed), new.at(schema), f"{place}/{name}")
        if rest is not False:
            yield from self.compare(old.at(keyed), new.at(rest), f"{place}/*")


def _is_always_there(schema: Any) -> bool:
    """Return whether an optional field is sent anyway, because it has a default."""
    return isinstance(schema, dict) and "default" in schema and schema["default"] is not None


def _may_be_missing(node: _Node, name: str) -> bool:
    """Return whether a field is left out at times: one with a default is sent with it."""
    schema: Any = node.schema["properties"][name]
    given = schema not in (True, False) and "default" in schema
    return name not in node.schema.get("required", ()) and not given


def _defaulted(old: Any, new: Any, place: str) -> Iterator[str]:
    """Yield that an omitted field means something else; null leaves it to the robot."""
    if not _is_always_there(old):
        return
    before, after = old["default"], None if new in (True, False) else new.get("default")
    if after is not None and before != after:
        yield f"{place} is {after} if left out, not {before}"


def _items(old: _Node, new: _Node) -> Iterator[tuple[_Node, _Node]]:
    mine, theirs = old.schema.get("prefixItems", []), new.schema.get("prefixItems", [])
    rest, others = old.schema.get("items", {}), new.schema.get("items", {})
    for one, other in itertools.zip_longest(mine, theirs):
        yield old.at(rest if one is None else one), new.at(others if other is None else other)
    yield old.at(rest), new.at(others)


def _disjoint(old: _Node, new: _Node, place: str) -> Iterator[str]:
    """Yield the bounds that leave none of the values of `old`."""
    for lower, upper in _RANGES:
        for ours, theirs, sign in ((upper, lower, 1), (lower, upper, -1)):
            bound, own = new.schema.get(theirs), old.schema.get(ours)
            if bound is not None and own is not None and sign * bound > sign * own:
                yield f"{_where(place)} is bounded by {theirs} {bound:g}"


def _narrowed(wide: _Node, narrow: _Node, place: str, says: str = "is bounded by") -> Iterator[str]:
    """Yield the bounds of `narrow` that `wide` goes beyond."""
    for names, tighter in ((_LOWER, max), (_UPPER, min)):
        for name in names:
            bound, own = narrow.schema.get(name), wide.schema.get(name)
            if bound is None:
                continue
            if own is None:
                other = name.replace("exclusiveM", "m")
                other = other if other != name else "exclusiveM" + name[1:]
                own = wide.schema.get(other)
                strict = name.startswith("exclusive") and own == bound
                if own is not None and not strict and tighter(own, bound) == own:
                    continue
            elif tighter(own, bound) == own:
                continue
            yield f"{_where(place)} {says} {name} {bound:g}"
    for name in _TEXT:
        if name in narrow.schema and narrow.schema[name] != wide.schema.get(name):
            yield f"{_where(place)} {says} {name} {narrow.schema[name]}"


def _listed(words: set[Any]) -> str:
    return ", ".join(sorted(map(str, words)))
