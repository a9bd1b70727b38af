"""`rcpctl fleet`: the robots of a hub, each with its gateway and the link to it."""

from __future__ import annotations

from typing import Any

from rcp_client.client import Client
from rcp_client.console.output import Output, clean

__all__ = ["fleet"]

_FAILED = 1
_LINKS = "/tenant/*/sensor/**/link"
_LINK = "GatewayLink."
"""Prefix of the value schema id of every link that a hub shows."""
_RANK = {"down": 0, "degraded": 1, "ready": 2}
"""Order of the states; one that is not known here comes first."""
_HEAD = (
    "ROBOT", "STATE", "GATEWAY", "RCP", "ROUND TRIP", "CLOCK", "SENT", "RECEIVED", "LOST", "LAST SEEN"
)  # fmt: skip


async def fleet(client: Client, out: Output, _: dict[str, Any]) -> int:
    """List the robots, those with a problem first."""
    listed = await client.discover(_LINKS, op="read", schemas=False)
    paths = {one.path for one in listed if one.schema_ids.get("value", "").startswith(_LINK)}
    if not paths:
        return await _nothing(client, out)
    found: list[dict[str, Any]] = []
    async for items in client.pages(_LINKS):
        found += [_row(item) for item in items if item["path"] in paths]
    found.sort(key=lambda row: (_RANK.get(row["state"], -1), row["robot"]))
    if out.json:
        for row in found:
            out.document(row)
    else:
        _show(out, found)
    return 0


async def _nothing(client: Client, out: Output) -> int:
    """Say why there is nothing to show."""
    backends = (await client.status()).get("backends") or []
    if any(one.get("gateways") for one in backends):
        out.aside("No robot that you may see has dialled in yet.")
        return 0
    out.aside("rcpctl: this gateway is not the hub of a fleet. Pass the hub's address with --url.")
    return _FAILED


def _row(item: dict[str, Any]) -> dict[str, Any]:
    _, _, tenant, _, *robot, _ = item["path"].split("/")
    row = {"robot": "/".join(("/tenant", tenant, *robot)), "state": "unknown"}
    if item.get("status") == "completed":
        return row | item["body"]
    return row | {"state": "down", "detail": (item.get("error") or {}).get("message")}


def _show(out: Output, found: list[dict[str, Any]]) -> None:
    troubled = [row for row in found if row["state"] != "ready"]
    for row in troubled:
        out.line(f"{row['robot']} is {out.paint(row['state'])}: {clean(row.get('detail') or '')}")
    early = [row for row in found if row.get("lacks")]
    for row in early:
        out.line(f"The gateway of {row['robot']} does not offer {', '.join(row['lacks'])}")
    if troubled or early:
        out.line()
    rows = [
        (
            row["robot"],
            row["state"],
            row.get("version"),
            row.get("protocol"),
            _milliseconds(row.get("latency")),
            _clock(row),
            _bytes(row.get("sent")),
            _bytes(row.get("received")),
            row.get("lost"),
            (row.get("last_seen") or "never")[:19].replace("T", " "),
        )
        for row in found
    ]
    out.table(_HEAD, rows)


def _milliseconds(seconds: float | None) -> str | None:
    return None if seconds is None else f"{seconds * 1e3:.1f} ms"


def _clock(row: dict[str, Any]) -> str | None:
    offset, bound = row.get("clock_offset"), row.get("clock_bound")
    if offset is None or bound is None:
        return None
    return f"{offset * 1e3:+.1f} ± {bound * 1e3:.1f} ms"


def _bytes(count: int | None) -> str | None:
    if count is None:
        return None
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} B"
