"""Section 4 of the contract: values, and how each encoding carries the odd ones."""

from __future__ import annotations

import base64
import math
from typing import Any

from rcp_gateway.testing._client import Client
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import Wire, World
from rcp_kernel.values import Encoding

__all__ = ["Values"]

PARCEL = "/param/parcel"
MANY = 40_000  # lists, each of which counts for nine values
ODD = {
    "NaN": math.nan,
    "Infinity": math.inf,
    "-Infinity": -math.inf,
}
NO_LIMITS: tuple[Any, ...] = (None, "1", [], {}, True, -0.1, 2.6, "NaN")
WIDE = (2**53, -(2**53), 2**63 - 1, -(2**63))
DATA = bytes(range(256))
PLAIN: dict[str, Any] = {
    "i64": -42,
    "u64": 42,
    "real": -0.0,
    "finite": 1e-300,
    "text": 'ä€𝄞\x00\n"\\',
    "data": "",
    "flag": True,
    "items": [0.1, 1e308, 5e-324],
    "table": {"": 1, "ä": -1},
    "nothing": None,
}


async def _written(client: Client, **fields: Any) -> dict[str, Any]:
    reply = await client.request("write", PARCEL, body=fields)
    assert reply["status"] == "completed", reply
    read = await client.request("read", PARCEL)
    assert str(read["body"]) == str(reply["body"])
    return reply["body"]


async def _refused(client: Client, **fields: Any) -> str:
    reply = await client.request("write", PARCEL, body=fields)
    assert reply["status"] == "rejected", reply
    return reply["error"]["code"]


class Values(Wire):
    """Tests of valid, returned and refused values."""

    @proves("value.schema-in")
    async def test_a_value_that_does_not_fit_never_reaches_the_robot(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for body in NO_LIMITS:
                reply = await client.request("write", "/param/limit", body=body)
                assert reply["error"]["code"] in ("invalid_value", "out_of_range"), body
            long = await client.request("write", "/param/label", body="x" * 21)
            assert long["error"]["code"] == "invalid_value"
            for body in ({"i64": 1, "more": 2}, {"i64": "x"}, {"items": [None]}, {"flag": 1}):
                assert await _refused(client, **body) == "invalid_value"
        assert world.robot().writes == []

    @proves("limits.values")
    async def test_more_values_than_a_message_may_hold_are_refused(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            lists: list[list[Any]] = [[]] * MANY
            await client.send(type="write", path=PARCEL, body=lists)
            # The message is not decoded, so the refusal may not name its id.
            reply = await client.until(lambda m: "error" in m)
            assert (reply["status"], reply["error"]["code"]) == ("rejected", "payload_too_large")
            assert world.robot().writes == []
            assert (await client.request("ping"))["status"] == "completed"

    @proves("value.schema-out")
    async def test_a_value_that_does_not_fit_is_a_fault_and_is_not_delivered(
        self, world: World
    ) -> None:
        client = await world.client()
        for name, bad in (("level", math.nan), ("level", "high"), ("pose", 3), ("level", None)):
            world.publish(f"sensor/{name}", bad)
            reply = await client.request("read", f"/sensor/{name}")
            assert reply["error"]["code"] == "device_rejected", bad
            assert reply["error"]["origin"] == "main"
        (main,) = [
            b for b in (await client.request("status"))["body"]["backends"] if b["name"] == "main"
        ]
        assert main["faults"] == 4

    @proves("value.schema-result")
    async def test_a_result_that_does_not_fit_is_not_delivered(self, world: World) -> None:
        reply = await (await world.client()).request("execute", "/service/liar")
        assert reply["status"] != "completed"
        assert reply["error"]["code"] == "device_rejected"
        assert "body" not in reply

    @proves("value.nonfinite")
    async def test_a_number_that_is_not_finite_is_a_text_in_json_and_native_elsewhere(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for name, number in ODD.items():
                sent = name if encoding is Encoding.JSON else number
                body = await _written(client, real=sent, items=[sent, 1.0])
                for found in (body["real"], body["items"][0]):
                    if encoding is Encoding.JSON:
                        assert found == name
                    else:
                        assert isinstance(found, float)
                        assert str(found) == str(number)

    @proves("value.nonfinite-refused")
    async def test_a_command_refuses_what_is_not_finite_where_its_schema_does(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            odd: list[Any] = list(ODD) if encoding is Encoding.JSON else [*ODD, *ODD.values()]
            for value in odd:
                assert await _refused(client, finite=value) == "invalid_value"
                go = await client.request("execute", "/action/go", body={"distance": value})
                assert go["error"]["code"] in ("invalid_value", "out_of_range"), value
        assert (world.robot().writes, world.robot().ran) == ([], [])

    @proves("value.wide")
    async def test_a_wide_integer_is_a_text_in_json_and_native_elsewhere(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for number in WIDE:
                for sent in (number, str(number)):
                    body = await _written(client, i64=sent, table={"n": sent})
                    expected = str(number) if encoding is Encoding.JSON else number
                    assert body["i64"] == body["table"]["n"] == expected
            top = await _written(client, u64=str(2**64 - 1))
            assert int(top["u64"]) == 2**64 - 1
            small = await _written(client, i64=str(2**53 - 1))
            assert small["i64"] == 2**53 - 1

    @proves("value.too-wide")
    async def test_an_integer_past_its_type_is_refused_however_it_is_written(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for field, number in (("i64", 2**63), ("i64", -(2**63) - 1), ("u64", -1)):
                assert await _refused(client, **{field: str(number)}) in (
                    "invalid_value",
                    "out_of_range",
                )
            assert await _refused(client, u64=str(2**64)) in ("invalid_value", "out_of_range")
            if encoding is Encoding.JSON:
                assert await _refused(client, i64=2**63) in ("invalid_value", "out_of_range")
                assert await _refused(client, u64=2**64) in ("invalid_value", "out_of_range")

    @proves("value.bytes")
    async def test_bytes_are_base64_in_json_and_native_elsewhere(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            sent: Any = base64.b64encode(DATA).decode() if encoding is Encoding.JSON else DATA
            assert (await _written(client, data=sent))["data"] == sent
        client = await world.client()
        assert await _refused(client, data="no base64!") == "invalid_value"

    @proves("value.round-trip")
    async def test_what_goes_in_comes_out_the_same(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            sent = PLAIN if encoding is Encoding.JSON else PLAIN | {"data": b""}
            assert str(await _written(client, **sent)) == str(sent)
            echo = await client.request("execute", "/service/echo", body=sent)
            assert str(echo["body"]) == str(sent)

    @proves("value.shared-encoding")
    async def test_a_value_is_the_same_in_every_encoding(self, world: World) -> None:
        clients = [await world.client(encoding=encoding) for encoding in self.encodings]
        for writer in clients:
            text = writer.encoding is Encoding.JSON
            real: Any = "NaN" if text else math.nan
            data: Any = base64.b64encode(DATA).decode() if text else DATA
            await _written(writer, i64=str(WIDE[2]), real=real, data=data)
            for reader in clients:
                body = (await reader.request("read", PARCEL))["body"]
                assert int(body["i64"]) == WIDE[2]
                assert math.isnan(float(body["real"]))
                found = body["data"]
                assert (base64.b64decode(found) if isinstance(found, str) else found) == DATA
