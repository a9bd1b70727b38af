"""Plan files: `.plan` of QGroundControl, `.waypoints` of Mission Planner (QGC WPL 110)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple, TypeGuard

import msgspec

from rcp_mavlink.messages import Item

__all__ = ["FORMATS", "Fault", "Names", "PlanFile", "parsed"]

_WPL = "QGC WPL"
_COLUMNS = 12  # index, current, frame, command, four parameters, latitude, longitude, altitude, autocontinue
_FRAMES: Mapping[int, Any] = {0: "absolute", 2: "mission", 3: "relative", 5: "absolute", 6: "relative", 10: "terrain", 11: "terrain"}  # fmt: skip
_NUMBERS = {"absolute": 0, "mission": 2, "relative": 3, "terrain": 10}
_POLYGON = {True: "NAV_FENCE_POLYGON_VERTEX_INCLUSION", False: "NAV_FENCE_POLYGON_VERTEX_EXCLUSION"}
_CIRCLE = {True: "NAV_FENCE_CIRCLE_INCLUSION", False: "NAV_FENCE_CIRCLE_EXCLUSION"}
_RETURN, _RALLY = "NAV_FENCE_RETURN_POINT", "NAV_RALLY_POINT"
_LARGEST = 3.4e38  # of a REAL32
_COMMANDS = 0xFFFF
_MOST = 10_000  # items of one part
_TOO_MANY = f"it has more than {_MOST} items"
_QUOTED = 80  # characters of a faulty text that are repeated
_PLACES = ((-90.0, 90.0), (-180.0, 180.0), (-500.0, 20_000.0))


class Names(NamedTuple):
    """The commands of a dialect, without `MAV_CMD_`."""

    by_number: Mapping[int, str]
    by_name: Mapping[str, int]


class Fault(NamedTuple):
    """What is wrong with a file, and where: `line 4`, `mission item 3`."""

    where: str
    reason: str


class PlanFile(NamedTuple):
    """What a file holds; None is nothing, an empty one clears it."""

    mission: tuple[Item, ...] | None = None
    fence: tuple[Item, ...] | None = None
    rally: tuple[Item, ...] | None = None


class _WrongPlan(Exception):
    """A part of a file cannot be read."""


def parsed(text: str, names: Names) -> tuple[PlanFile, list[Fault]]:
    """Read a file of either kind; return what it holds, and what is wrong with the rest."""
    text = text.lstrip("\ufeff")
    if text.startswith(_WPL):
        return _waypoints(text, names)
    try:
        plan: Any = msgspec.json.decode(text)
        if not isinstance(plan, dict) or plan.get("fileType") != "Plan":
            return PlanFile(), [Fault("the file", 'no plan: "fileType" is not "Plan"')]
        return _plan(plan, names)
    except msgspec.DecodeError as error:
        return PlanFile(), [Fault("the file", f"neither {_WPL} nor JSON: {error}")]
    except RecursionError:
        return PlanFile(), [Fault("the file", "its parts are nested too deeply")]


# QGC WPL 110


def _waypoints(text: str, names: Names) -> tuple[PlanFile, list[Fault]]:
    items: list[Item] = []
    faults: list[Fault] = []
    expected = 0
    lines = text.splitlines()[1:]
    if len(lines) > _MOST:
        return PlanFile(), [Fault("the file", _TOO_MANY)]
    for number, line in enumerate(lines, 2):
        columns = line.split()
        if not columns:
            continue
        try:
            item = _row(columns, expected, names)
        except _WrongPlan as wrong:
            faults.append(Fault(f"line {number}", str(wrong)))
        else:
            if expected:  # row 0 is home
                items.append(item)
        expected += 1
    return PlanFile(mission=tuple(items)), faults


def _row(columns: Sequence[str], expected: int, names: Names) -> Item:
    if len(columns) != _COLUMNS:
        raise _WrongPlan(f"expected {_COLUMNS} columns, not {len(columns)}")
    try:
        index, frame, command = (int(columns[n]) for n in (0, 2, 3))
        rest = [float(column) for column in columns[4:11]]
    except ValueError as error:
        raise _WrongPlan(f"not a number: {_shown(error)}") from error
    if index != expected:
        raise _WrongPlan(f"expected item {expected}, not {index}")
    return _item(command, frame, rest, names)


def _write_waypoints(plan: PlanFile, home: Sequence[float], names: Names) -> str:
    """Write the mission, with home as its row 0."""
    rows = [_columns(0, Item("NAV_WAYPOINT", home[0], home[1], home[2], "absolute"), names)]
    rows += [_columns(place, item, names) for place, item in enumerate(plan.mission or (), 1)]
    return "QGC WPL 110\n" + "".join("\t".join(row) + "\n" for row in rows)


def _columns(place: int, item: Item, names: Names) -> list[str]:
    p = [0.0 if each is None else each for each in _four(item)]
    numbers = (*p, item.latitude, item.longitude, item.altitude)
    command = names.by_name.get(item.command, item.command)
    head = (place, int(place == 0), _NUMBERS[item.frame], command)
    return [*map(str, head), *(f"{number:.8f}" for number in numbers), "1"]


# .plan


def _plan(plan: dict[str, Any], names: Names) -> tuple[PlanFile, list[Fault]]:
    faults: list[Fault] = []

    def part(name: str, read: Callable[[Any], Iterable[Item]]) -> tuple[Item, ...] | None:
        given = plan.get(name)
        if given is None:
            return None
        found: list[Item] = []
        try:
            if not isinstance(given, dict):
                raise _WrongPlan("not an object")
            found.extend(islice(read(given), _MOST + 1))
            if len(found) > _MOST:
                raise _WrongPlan(_TOO_MANY)
        except _WrongPlan as wrong:
            faults.append(Fault(name, str(wrong)))
        return tuple(found)

    def mission(given: dict[str, Any]) -> Iterator[Item]:
        for place, each in enumerate(_list(given, "items")):
            try:
                yield from _mission_items(each, names)
            except _WrongPlan as wrong:
                faults.append(Fault(f"mission item {place + 1}", str(wrong)))

    return PlanFile(
        part("mission", mission), part("geoFence", _fence), part("rallyPoints", _rally)
    ), faults


def _mission_items(given: Any, names: Names) -> Iterator[Item]:
    kind = given.get("type") if isinstance(given, dict) else None
    if kind == "ComplexItem":
        flown = given.get("TransectStyleComplexItem")
        if not isinstance(flown, dict):
            name = given.get("complexItemType", "of an unknown kind")
            raise _WrongPlan(
                f"a complex item, {_shown(name)}, whose waypoints the file does not hold; save it as waypoints"
            )
        for each in _list(flown, "Items"):
            yield from _mission_items(each, names)
        return
    if kind != "SimpleItem":
        raise _WrongPlan(f'"type" is neither SimpleItem nor ComplexItem, but {_shown(repr(kind))}')
    params = _list(given, "params")
    if len(params) != 7 or not all(each is None or _is_number(each) for each in params):
        raise _WrongPlan('"params" are not seven numbers')
    command, frame = given.get("command"), given.get("frame")
    if not isinstance(command, int) or not isinstance(frame, int):
        raise _WrongPlan('"command" and "frame" are not whole numbers')
    yield _item(command, frame, params, names)


def _fence(given: dict[str, Any]) -> Iterator[Item]:
    for place, each in enumerate(_list(given, "polygons"), 1):
        corners = _list(each, "polygon")
        if len(corners) < 3:
            raise _WrongPlan(f"polygon {place} has fewer than three corners")
        name = _POLYGON[bool(each.get("inclusion", True))]
        for corner in corners:
            lat, lon, _ = _place(corner)
            yield Item(name, lat, lon, params=(float(len(corners)),))
    for place, each in enumerate(_list(given, "circles"), 1):
        circle = each.get("circle") if isinstance(each, dict) else None
        radius = circle.get("radius") if isinstance(circle, dict) else None
        if not isinstance(circle, dict) or not _is_number(radius) or not 0 < radius <= _LARGEST:
            raise _WrongPlan(f"circle {place} has no radius, or one without end")
        lat, lon, _ = _place(circle.get("center"))
        yield Item(_CIRCLE[bool(each.get("inclusion", True))], lat, lon, params=(float(radius),))
    if (back := given.get("breachReturn")) is not None:
        lat, lon, altitude = _place(back)
        yield Item(_RETURN, lat, lon, altitude)


def _rally(given: dict[str, Any]) -> Iterator[Item]:
    for point in _list(given, "points"):
        lat, lon, altitude = _place(point)
        yield Item(_RALLY, lat, lon, altitude)


def _write_plan(plan: PlanFile, home: Sequence[float], names: Names) -> str:
    """Write mission, fence and rally points."""
    mission = [_simple(place, item, names) for place, item in enumerate(plan.mission or (), 1)]
    made = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": 0,
            "vehicleType": 0,
            "cruiseSpeed": 15,
            "hoverSpeed": 5,
            "plannedHomePosition": list(home),
            "items": mission,
        },
        "geoFence": _fence_of(plan.fence or ()),
        "rallyPoints": {
            "version": 2,
            "points": [[p.latitude, p.longitude, p.altitude] for p in plan.rally or ()],
        },
    }
    return msgspec.json.format(msgspec.json.encode(made), indent=4).decode()


def _simple(place: int, item: Item, names: Names) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "command": names.by_name.get(item.command) or int(item.command),
        "frame": _NUMBERS[item.frame],
        "params": [*_four(item), item.latitude, item.longitude, item.altitude],
        "autoContinue": True,
        "doJumpId": place,
    }


def _fence_of(items: Sequence[Item]) -> dict[str, Any]:
    polygons: list[dict[str, Any]] = []
    circles: list[dict[str, Any]] = []
    found: dict[str, Any] = {"version": 2, "polygons": polygons, "circles": circles}
    wanted = 0
    for item in items:
        where = [item.latitude, item.longitude]
        if item.command == _RETURN:
            found["breachReturn"] = [*where, item.altitude]
        elif item.command in _CIRCLE.values():
            inside = item.command == _CIRCLE[True]
            circle = {"center": where, "radius": _four(item)[0]}
            circles.append({"circle": circle, "inclusion": inside, "version": 1})
        elif item.command in _POLYGON.values():
            if not wanted:
                wanted = int(_four(item)[0] or 0)
                inside = item.command == _POLYGON[True]
                polygons.append({"polygon": [], "inclusion": inside, "version": 1})
            polygons[-1]["polygon"].append(where)
            wanted -= 1
    return found


FORMATS: Mapping[str, Callable[[PlanFile, Sequence[float], Names], str]] = {
    "plan": _write_plan,
    "waypoints": _write_waypoints,
}
"""Writers of a file from a plan, home (latitude, longitude, height above the sea) and the commands."""


# Both


def _item(command: int, frame: int, numbers: Sequence[float | None], names: Names) -> Item:
    """Return an item of seven numbers; of its parameters, NaN and None stand for `not set`."""
    word = _FRAMES.get(frame)
    if word is None:
        raise _WrongPlan(f"frame {_shown(frame)} is none of {', '.join(map(str, _FRAMES))}")
    if not 0 <= command <= _COMMANDS:
        raise _WrongPlan(f"command {_shown(command)} is not within 0 to {_COMMANDS}")
    if any(each is not None and abs(each) > _LARGEST for each in numbers):
        raise _WrongPlan("a number is too large for a MAVLink message")
    params = tuple(None if p is None or math.isnan(p) else float(p) for p in numbers[:4])
    at = [0.0 if p is None or math.isnan(p) else float(p) for p in numbers[4:]]
    if word != "mission":
        at = list(_within(at))
    elif not all(low <= each <= high for each, (low, high) in zip(at, _PLACES, strict=True)):
        raise _WrongPlan(f"parameters 5 to 7, {at}, are too large")
    return Item(names.by_number.get(command, str(command)), at[0], at[1], at[2], word, params)


def _place(given: Any) -> tuple[float, float, float]:
    numbers: list[Any] = list(given) if isinstance(given, list) else []
    if len(numbers) not in (2, 3) or not all(_is_number(n) and abs(n) <= _LARGEST for n in numbers):
        raise _WrongPlan(f"{_shown(given)} is no position of two or three numbers")
    return _within([*map(float, numbers), 0.0][:3])


def _within(at: Sequence[float]) -> tuple[float, float, float]:
    for word, each, (low, high) in zip(
        ("latitude", "longitude", "altitude"), at, _PLACES, strict=True
    ):
        if not low <= each <= high:
            raise _WrongPlan(f"{word} {each:g} is not within {low:g} to {high:g}")
    return at[0], at[1], at[2]


def _four(item: Item) -> list[float | None]:
    return [*item.params, 0.0, 0.0, 0.0, 0.0][:4]


def _list(given: Any, name: str) -> list[Any]:
    found = given.get(name, []) if isinstance(given, dict) else None
    if not isinstance(found, list):
        raise _WrongPlan(f'"{name}" is not a list')
    return found


def _shown(value: object) -> str:
    text = str(value)
    return text if len(text) <= _QUOTED else f"{text[:_QUOTED]}…"


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
