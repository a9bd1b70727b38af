"""A robot's claim: its profiles, and the robot-specific part of each resource."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypedDict, Unpack

from msgspec import structs

from rcp_profiles.bounds import Bound, Bounds, bounded
from rcp_profiles.compatibility import unaccepted, unexpected
from rcp_profiles.profile import Definition, Profile
from rcp_profiles.standard import profile_named
from rcp_protocol.errors import PluginError, RcpError
from rcp_protocol.model import BRANCHES, Kind, Operation, Policy, Resource, kind_of, operation_names
from rcp_protocol.values import value_type

__all__ = ["Offer", "Particulars", "claim", "offer"]

_CALLS = (Kind.ACTION, Kind.SERVICE)


class Particulars(TypedDict, total=False):
    """The fields of `Resource` that a robot may set for a resource of a profile."""

    description: str
    value: Any
    input: Any
    output: Any
    feedback: Any
    operations: Operation
    examples: tuple[Any, ...]
    live: bool
    deadline: float
    timeout: float
    policy: Policy
    outlives: bool
    max_age: float
    valid_for: float
    safe: Any
    moves: bool
    energises: bool
    atomic: str
    history: int
    native: str
    meta: dict[str, Any]


class Offer(NamedTuple):
    """One resource of a profile, as one robot offers it."""

    name: str
    bounds: Bounds
    particulars: Particulars


def offer(
    name: str, bounds: Bounds | Bound | None = None, **particulars: Unpack[Particulars]
) -> Offer:
    """Offer a resource of a profile: its types, units, frame and description are the profile's.

    `bounds` are the robot's limits, by the place in the value or input: `{"linear.x": (-1.0, 1.0)}`,
    or one pair where the value is a number. The `particulars` are fields of `Resource`; a type among
    them takes the place of the profile's and must be compatible with it.
    """
    if isinstance(bounds, tuple):
        bounds = {"": bounds}
    return Offer(name, bounds or {}, particulars)


def claim(
    profiles: Sequence[str | Profile],
    *offers: str | Offer | Resource,
    robot: str | None = None,
    place: str | None = None,
) -> list[Resource]:
    """Return the resources of a robot that has some profiles, for `Host.declare`.

    An offer is the name of a resource, an `offer(…)` of one, or a whole `Resource`; one whose name no
    profile has passes unchanged, as the robot's own. Names are the profiles' (`sensor/pose`): where a
    backend has several robots, `robot` becomes the segment after the branch and what an e-stop can stop
    alone (`Resource.robot`); `place` becomes that segment without the latter.

    :raises PluginError: a required resource is missing, or one is not what the profile says.
    """
    claimed = _profiles(profiles)
    definitions = _definitions(claimed)
    found: dict[str, Resource] = {}
    problems: list[str] = []
    for one in offers:
        own = Offer(one, {}, {}) if isinstance(one, str) else one
        definition = definitions.get(own.name)
        try:
            found[own.name] = resource = _resource(own, definition)
            if definition is not None:
                problems += _differences(definition, resource)
        except (PluginError, RcpError) as error:
            problems.append(f"{own.name}: {error}")
    problems += _missing(claimed, found)
    if problems:
        what = ", ".join(profile.id for profile in claimed)
        raise PluginError(f"the claim of {what} does not hold: {'; '.join(problems)}")
    segment = place or robot
    names = {profile.id: profile.definitions.keys() for profile in claimed}
    return [
        structs.replace(
            resource,
            name=_placed(resource.name, segment),
            robot=robot or resource.robot,
            profiles=tuple(id_ for id_, own in names.items() if name in own),
        )
        for name, resource in found.items()
    ]


def _profiles(names: Sequence[str | Profile]) -> list[Profile]:
    given = [profile_named(name) if isinstance(name, str) else name for name in names]
    return list({one.id: one for profile in given for one in profile.whole}.values())


def _definitions(profiles: list[Profile]) -> dict[str, Definition]:
    found: dict[str, Definition] = {}
    for profile in profiles:
        for definition in profile.resources:
            known = found.setdefault(definition.name, definition)
            if known.resource != definition.resource or known.frame != definition.frame:
                raise PluginError(f"the profiles define '{definition.name}' in different ways")
    return found


def _resource(own: Offer | Resource, definition: Definition | None) -> Resource:
    if isinstance(own, Resource):
        return own
    if definition is None:
        raise PluginError("none of the claimed profiles has it; give a whole Resource")
    made = structs.replace(definition.resource, **own.particulars)
    part = "input" if kind_of(own.name) in _CALLS else "value"
    made = structs.replace(made, **{part: bounded(getattr(made, part), own.bounds)})
    if "examples" not in own.particulars:
        made = structs.replace(made, examples=tuple(_fitting(getattr(made, part), made.examples)))
    return made


def _fitting(type_: Any, examples: tuple[Any, ...]) -> Iterator[Any]:
    """Keep the definition's examples that are within the robot's limits."""
    known = value_type(type_)
    for example in examples:
        try:
            known.convert(example)
        except RcpError:
            continue
        yield example


def _missing(profiles: list[Profile], found: dict[str, Resource]) -> Iterator[str]:
    for profile in profiles:
        for one in profile.resources:
            if one.required and not one.gateway and one.name not in found:
                yield f"{one.name} is missing, which {profile.id} requires"


def _differences(definition: Definition, own: Resource) -> Iterator[str]:
    """Yield the deviations of a resource from its definition."""
    name, defined = own.name, definition.resource
    kind = kind_of(name)
    offered = BRANCHES[kind] if own.operations is None else own.operations
    if lacking := definition.operations & ~offered:
        yield f"{name} does not offer {', '.join(operation_names(lacking))}"
    if defined.valid_for is not None and own.valid_for is None:
        yield f"{name} has no `valid_for`"
    if defined.energises and not own.energises:
        yield f"{name} does not say that it `energises`"
    if kind in _CALLS:
        yield from _sent(name, "input", defined.input, own.input)
        yield from _received(name, "output", defined.output, own.output)
        yield from _received(name, "feedback", defined.feedback, own.feedback)
        return
    yield from _received(name, "value", defined.value, own.value)
    if Operation.WRITE in definition.operations:
        yield from _sent(name, "value", defined.value, own.value)


def _sent(name: str, part: str, defined: Any, own: Any) -> Iterator[str]:
    if own == defined:
        return
    for problem in unaccepted(value_type(defined).schema, value_type(own).schema, limits=True):
        yield f"{name}, {part}: {problem}"


def _received(name: str, part: str, defined: Any, own: Any) -> Iterator[str]:
    if defined is None or own == defined:  # the profile guarantees nothing, and more is allowed
        return
    if own is None:
        yield f"{name} has no {part}"
        return
    for problem in unexpected(value_type(defined).schema, value_type(own).schema):
        yield f"{name}, {part}: {problem}"


def _placed(name: str, segment: str | None) -> str:
    branch, _, rest = name.partition("/")
    return f"{branch}/{segment}/{rest}" if segment else name
