"""`rcpctl replay`: recordings that the gateway plays."""

from __future__ import annotations

from typing import Any

from rcp_client.client import Client
from rcp_client.console.output import Output

__all__ = ["replay"]

Arguments = dict[str, Any]
_FAILED = 1
_HEAD = ("PATH", "STATE", "AT", "PLAYED", "SPEED", "LOOP", "FILES")
_CHANGES = ("paused", "speed", "seek", "step", "loop")


async def replay(client: Client, out: Output, args: Arguments) -> int:
    """Control a replay, or show where each one is."""
    changing = any(args[name] is not None for name in _CHANGES)
    paths = await _paths(client, changing=changing)
    if (given := args["path"]) is not None:
        own = "" if given.startswith("/tenant/") else f"/tenant/{client.greeting.get('tenant')}"
        paths = [path for path in paths if _is_at(path, own + given)]
    if not paths:
        where = "" if given is None else f" at {given}"
        may = " that you may control" if changing else ""
        out.aside(f"rcpctl: there is no replay{where}{may}.")
        return _FAILED
    if not changing:
        return await _show(client, out, paths)
    if len(paths) > 1:
        out.aside(f"rcpctl: there are several replays, name one of them: {', '.join(paths)}.")
        return _FAILED
    (path,) = paths
    state = await client.request({"type": "execute", "path": _control(path), "body": _body(args)})
    _tell(out, path, state.body)
    return 0


async def _paths(client: Client, *, changing: bool) -> list[str]:
    """Return the states of the replays that may be read, or of those that may be controlled."""
    if not changing:
        found = await client.discover("/tenant/*/sensor/**", op="read", schemas=False)
        return [one.path for one in found if one.meta.get("replay") == "state"]
    found = await client.discover("/tenant/*/service/**", op="execute", schemas=False)
    return [
        one.path.replace("/service/", "/sensor/", 1)
        for one in found
        if one.meta.get("replay") == "control"
    ]


def _is_at(path: str, given: str) -> bool:
    """Return whether a replay is at a path: its own two, its robot's, or its tenant's."""
    parts, wanted = path.split("/"), given.rstrip("/").split("/")
    robot = [*parts[:3], *parts[4:-1]]
    return given in (path, _control(path)) or wanted in (robot, parts[:3])


def _control(path: str) -> str:
    return path.replace("/sensor/", "/service/", 1)


def _body(args: Arguments) -> Arguments:
    body = {name: args[name] for name in _CHANGES if args[name] is not None}
    seek = body.get("seek")
    if seek is not None and seek.replace(".", "", 1).isdigit():
        body["seek"] = float(seek)
    return body


async def _show(client: Client, out: Output, paths: list[str]) -> int:
    states = {path: await client.read(path) for path in paths}
    if len(states) == 1 or out.json:
        for path, state in states.items():
            _tell(out, path, state)
        return 0
    out.table(
        _HEAD,
        [
            (
                path,
                state["state"],
                state["position"],
                _place(state),
                f"{state['speed']:g}x",
                "yes" if state["loop"] else "",
                ", ".join(state["recordings"]),
            )
            for path, state in states.items()
        ],
    )
    return 0


def _tell(out: Output, path: str, state: dict[str, Any]) -> None:
    if out.json:
        out.document({"path": path} | state)
        return
    loop = ", looping" if state["loop"] else ""
    out.line(
        f"{out.paint(state['state'])} {state['position']} "
        f"({_place(state)}, {state['speed']:g}x{loop})"
    )


def _place(state: dict[str, Any]) -> str:
    return f"{state['elapsed']:.1f} of {state['duration']:.1f} s"
