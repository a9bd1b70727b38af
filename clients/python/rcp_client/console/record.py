"""`rcpctl record`: recordings of the gateway."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from rcp_client.client import Client
from rcp_client.console.download import download
from rcp_client.console.output import Output

__all__ = ["fetch", "history", "listed", "pin", "start", "stop", "unpin"]

Arguments = dict[str, Any]
_PATH = "/system/recorder"
_FILES = "/rcp/v1/recordings/"
_HEAD = ("FILE", "STATE", "START", "END", "MESSAGES", "SIZE", "PINNED", "REASON")


async def listed(client: Client, out: Output, args: Arguments) -> int:
    """List recordings, those with all WORDS."""
    words = " ".join(args["words"]).lower().split()
    rows = await client.read(_PATH)
    found = [
        row
        for row in rows
        if all(
            word in f"{row['path']} {row.get('reason', '')} {row.get('robot', '')}".lower()
            for word in words
        )
    ]
    if out.json:
        for row in found:
            out.document(row)
        return 0
    if not found:
        out.aside("No recordings.")
        return 0
    out.table(
        _HEAD,
        [
            (
                row["path"],
                row["state"],
                _time(row["start"]),
                _time(row.get("end")),
                row["messages"],
                _size(row["bytes"]),
                "yes" if row.get("pinned") else "",
                row.get("reason", ""),
            )
            for row in found
        ],
    )
    return 0


async def start(client: Client, out: Output, args: Arguments) -> int:
    """Start a recording."""
    body: dict[str, Any] = {"name": args["name"], "paths": list(args["paths"])}
    if args["seconds"] is not None:
        body["seconds"] = args["seconds"]
    return await _execute(client, out, {"start": body})


async def stop(client: Client, out: Output, args: Arguments) -> int:
    """Stop a recording."""
    return await _execute(client, out, {"stop": args["name"]})


async def pin(client: Client, out: Output, args: Arguments) -> int:
    """Keep a file."""
    return await _execute(client, out, {"pin": args["file"]})


async def unpin(client: Client, out: Output, args: Arguments) -> int:
    """Keep a file no longer."""
    return await _execute(client, out, {"unpin": args["file"]})


async def _execute(client: Client, out: Output, body: dict[str, Any]) -> int:
    done = (await client.request({"type": "execute", "path": _PATH, "body": body})).body
    if out.json:
        out.document(done)
    else:
        paths = done.get("paths")
        more = "" if paths is None else f": {paths} path{'' if paths == 1 else 's'}"
        out.line(f"{done['name']} {done['done']}{more}")
    return 0


async def fetch(client: Client, out: Output, args: Arguments) -> int:
    """Download a file, or a bag of ROS 2: a folder with the file and its metadata."""
    name: str = args["file"]
    if not args["ros2"]:
        target = Path(args["output"] or name)
        return await _save(client, out, name, {}, target)
    folder = Path(args["output"] or name.removesuffix(".mcap"))
    await asyncio.to_thread(folder.mkdir, parents=True, exist_ok=True)
    bag = folder / f"{name.removesuffix('.mcap')}_0.mcap"
    await _save(client, out, name, {"format": "yaml"}, folder / "metadata.yaml")
    return await _save(client, out, name, {"format": "ros2"}, bag)


async def history(client: Client, out: Output, args: Arguments) -> int:
    """Save what was recorded of a path."""
    names = ("from", "to", "every", "thin", "format")
    query = {name: str(args[name]) for name in names if args[name]}
    if args["fields"]:
        query["fields"] = ",".join(args["fields"])
    path = args["path"]
    target = Path(args["output"] or f"{path.strip('/').replace('/', '.')}.{args['format']}")
    return await _get(client, out, f"/rcp/v1/context{path}", query, target)


async def _save(client: Client, out: Output, name: str, query: dict[str, str], target: Path) -> int:
    return await _get(client, out, _FILES + name, query, target)


async def _get(client: Client, out: Output, path: str, query: dict[str, str], target: Path) -> int:
    size = await asyncio.to_thread(download, client, path, query, target)
    if out.json:
        out.document({"file": str(target), "bytes": size})
    else:
        out.line(f"{target} {_size(size)}")
    return 0


def _time(text: str | None) -> str:
    return "" if text is None else text[:19].replace("T", " ")


def _size(count: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} B"
