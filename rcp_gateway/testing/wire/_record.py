"""Section 9 of the protocol: actions and refusals are recorded."""

from __future__ import annotations

from rcp_gateway.testing._client import Client, MemoryClient, Message
from rcp_gateway.testing._serve import ADMIN, VIEWER
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World
from rcp_gateway.testing.wire._sessions import RELIABLE

__all__ = ["Records"]

AUDIT = "/system/audit"
LIMIT = "/tenant/alpha/param/limit"


async def last(auditor: Client) -> Message:
    """Read the last record visible to a client."""
    reply = await auditor.request("read", AUDIT)
    assert reply["status"] == "completed", reply
    return reply["body"]


class Records(Wire):
    """Tests of audit records."""

    @proves("record.acts")
    async def test_a_write_is_on_record_once_it_is_answered(self, world: World) -> None:
        auditor, client = await world.client(ADMIN), await world.client()
        await auditor.request("ping")  # logins may be recorded too
        reply = await client.request("write", LIMIT, body=2.0, id="w-1")
        assert reply["status"] == "completed"
        record = await last(auditor)
        assert (record["what"], record["principal"], record["outcome"]) == (
            "write",
            "operator",
            "ok",
        )
        assert (record["path"], record["tenant"], record["value"]) == (LIMIT, "alpha", 2.0)
        assert (record["id"], record["request"]) == ("w-1", "write")

    @proves("record.acts")
    async def test_a_command_is_on_record_with_what_the_robot_said(self, world: World) -> None:
        auditor, client = MemoryClient(world.server.client_api, ADMIN), await world.client()
        records = await auditor.subscribe(AUDIT, **RELIABLE)
        reply = await client.request("execute", "/action/go", body={"distance": 3.0})
        entry = await auditor.until(
            lambda m: m.get("id") == records and m["body"]["what"] == "command"
        )
        record = entry["body"]
        assert (record["command"], record["status"]) == (reply["command"], "completed")
        assert record["value"] == 3.0
        await auditor.close()

    @proves("record.denials")
    async def test_a_refusal_is_on_record_once_it_is_answered(self, world: World) -> None:
        auditor, client = await world.client(ADMIN), await world.client(VIEWER)
        await auditor.request("ping")  # logins may be recorded too
        refused = await client.request("write", LIMIT, body=2.0)
        record = await last(auditor)
        assert (record["what"], record["principal"]) == ("denial", "viewer")
        assert (record["path"], record["outcome"]) == (LIMIT, refused["error"]["code"])

    @proves("record.hidden")
    async def test_the_record_is_not_there_for_who_may_not_see_it(self, world: World) -> None:
        for token in (VIEWER, LOCAL):
            client = await world.client(token)
            for type_ in ("read", "discover"):
                reply = await client.request(type_, AUDIT)
                hidden = reply.get("error", {}).get("code") == "unknown_path"
                assert hidden or reply["body"]["resources"] == [], reply
