"""What the conformance suite asks a server to have beside its own things. For tests only."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

from mcp import types
from mcp.shared.exceptions import MCPError

from rcp_mcp.caller import modern
from rcp_mcp.offers import Context, Method, Offer, Outcome

PNG = (
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5E"
    "rkJggg=="
)
WAV = base64.b64encode(
    b"RIFF\x24\0\0\0WAVEfmt \x10\0\0\0\1\0\1\0\x40\x1f\0\0\x40\x1f\0\0\1\0\x08\0data\0\0\0\0"
).decode()
_EMPTY: dict[str, Any] = {"type": "object", "properties": {}}
_TEXT = {"type": "string"}
_RICH: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "type": "object",
    "$defs": {
        "address": {
            "$anchor": "addressDef",
            "type": "object",
            "properties": {"street": _TEXT, "city": _TEXT},
        }
    },
    "properties": {
        "name": _TEXT,
        "address": {"$ref": "#/$defs/address"},
        "contactMethod": {"type": "string", "enum": ["phone", "email"]},
        "phone": _TEXT,
        "email": _TEXT,
    },
    "allOf": [{"anyOf": [{"required": ["phone"]}, {"required": ["email"]}]}],
    "if": {"properties": {"contactMethod": {"const": "phone"}}, "required": ["contactMethod"]},
    "then": {"required": ["phone"]},
    "else": {"required": ["email"]},
    "additionalProperties": False,
}
_HEADED: dict[str, Any] = {
    "type": "object",
    "properties": {"region": {"type": "string", "x-mcp-header": "Region"}},
    "required": ["region"],
}
Params = types.CallToolRequestParams
Call = Callable[[Context, Params], Awaitable[Outcome]]


def said(text: str) -> types.CallToolResult:
    return types.CallToolResult(content=[types.TextContent(type="text", text=text)])


def form(message: str, properties: dict[str, Any], required: list[str]) -> types.ElicitRequest:
    schema = {"type": "object", "properties": properties, "required": required}
    return types.ElicitRequest(
        params=types.ElicitRequestFormParams(message=message, requested_schema=schema)
    )


def question(text: str, tokens: int) -> types.CreateMessageRequest:
    content = types.TextContent(type="text", text=text)
    return types.CreateMessageRequest(
        params=types.CreateMessageRequestParams(
            messages=[types.SamplingMessage(role="user", content=content)], max_tokens=tokens
        )
    )


NAME = form("What is your name?", {"name": _TEXT}, ["name"])
CONFIRM = form("Please confirm", {"ok": {"type": "boolean"}}, ["ok"])


def asking(requests: dict[str, Any], state: str | None = None) -> types.InputRequiredResult:
    return types.InputRequiredResult(input_requests=requests, request_state=state)


def answers(params: Any) -> dict[str, Any]:
    return {
        key: one.model_dump(mode="json", by_alias=True, exclude_none=True)
        if hasattr(one, "model_dump")
        else one
        for key, one in (params.input_responses or {}).items()
    }


def accepted(params: Any, key: str, field: str) -> Any:
    """Return what somebody entered, or None if that is not there."""
    given = answers(params).get(key)
    if not isinstance(given, dict) or given.get("action") != "accept":
        return None
    return (given.get("content") or {}).get(field)


class Fixtures(Offer):
    """All of it; `change` changes the tree as callers see it."""

    def __init__(self, change: Callable[[], None]) -> None:
        self._change = change
        self._tools: dict[str, tuple[dict[str, Any], Call]] = {
            "test_simple_text": (_EMPTY, self._simple),
            "test_image_content": (_EMPTY, self._image),
            "test_audio_content": (_EMPTY, self._audio),
            "test_embedded_resource": (_EMPTY, self._embedded),
            "test_multiple_content_types": (_EMPTY, self._mixed),
            "test_tool_with_logging": (_EMPTY, self._logging),
            "test_logging_tool": (_EMPTY, self._logging),
            "test_error_handling": (_EMPTY, self._error),
            "test_tool_with_progress": (_EMPTY, self._progress),
            "test_sampling": (_with(prompt=_TEXT), self._sampling),
            "test_elicitation": (_with(message=_TEXT), self._elicitation),
            "test_elicitation_sep1034_defaults": (_EMPTY, self._defaults),
            "test_elicitation_sep1330_enums": (_EMPTY, self._enums),
            "test_reconnection": (_EMPTY, self._reconnection),
            "test_custom_headers": (_HEADED, self._simple),
            "json_schema_2020_12_tool": (_RICH, self._simple),
            "test_missing_capability": (_EMPTY, self._missing),
            "test_streaming_elicitation": (_EMPTY, self._elicited),
            "test_trigger_tool_change": (_EMPTY, self._changed),
            "test_input_required_result_elicitation": (_EMPTY, self._elicited),
            "test_input_required_result_sampling": (_EMPTY, self._sampled),
            "test_input_required_result_list_roots": (_EMPTY, self._rooted),
            "test_input_required_result_request_state": (_EMPTY, self._state),
            "test_input_required_result_tampered_state": (_EMPTY, self._state),
            "test_input_required_result_multiple_inputs": (_EMPTY, self._multiple),
            "test_input_required_result_multi_round": (_EMPTY, self._rounds),
            "test_input_required_result_capabilities": (_EMPTY, self._capable),
        }

    def methods(self) -> Sequence[Method]:
        async def level(ctx: Context, params: types.SetLevelRequestParams) -> types.EmptyResult:
            return types.EmptyResult()

        return [Method("logging/setLevel", types.SetLevelRequestParams, level)]

    def headed(self, tool: str) -> Mapping[str, Any] | None:
        return _HEADED if tool == "test_custom_headers" else None

    async def tools(self, ctx: Context) -> Sequence[types.Tool]:
        return [
            types.Tool(name=name, description=f"Fixture {name}.", input_schema=schema)
            for name, (schema, _) in self._tools.items()
        ]

    async def call(self, ctx: Context, params: Params) -> Outcome | None:
        found = self._tools.get(params.name)
        return None if found is None else await found[1](ctx, params)

    # -- tools ---------------------------------------------------------------------------------

    async def _simple(self, ctx: Context, params: Params) -> Outcome:
        return said("This is a simple text response for testing.")

    async def _image(self, ctx: Context, params: Params) -> Outcome:
        block = types.ImageContent(type="image", data=PNG, mime_type="image/png")
        return types.CallToolResult(content=[block])

    async def _audio(self, ctx: Context, params: Params) -> Outcome:
        block = types.AudioContent(type="audio", data=WAV, mime_type="audio/wav")
        return types.CallToolResult(content=[block])

    async def _embedded(self, ctx: Context, params: Params) -> Outcome:
        text = "This is an embedded resource content."
        return types.CallToolResult(content=[_resource("test://embedded-resource", text)])

    async def _mixed(self, ctx: Context, params: Params) -> Outcome:
        data = json.dumps({"test": "data", "value": 123})
        return types.CallToolResult(
            content=[
                types.TextContent(type="text", text="Multiple content types test:"),
                types.ImageContent(type="image", data=PNG, mime_type="image/png"),
                _resource("test://mixed-content-resource", data, "application/json"),
            ]
        )

    async def _logging(self, ctx: Context, params: Params) -> Outcome:
        for text in ("started", "processing", "completed"):
            words = "Tool processing data" if text == "processing" else f"Tool execution {text}"
            await ctx.session.send_log_message("info", words, related_request_id=ctx.request_id)
            await asyncio.sleep(0.05)
        return said("Logged.")

    async def _error(self, ctx: Context, params: Params) -> Outcome:
        found = said("This tool intentionally returns an error for testing")
        found.is_error = True
        return found

    async def _progress(self, ctx: Context, params: Params) -> Outcome:
        for part in (0, 50, 100):
            await ctx.session.report_progress(part, 100)
            await asyncio.sleep(0.05)
        return said("Done.")

    async def _sampling(self, ctx: Context, params: Params) -> Outcome:
        prompt = (params.arguments or {})["prompt"]
        found = await _ask(ctx, question(prompt, 100), types.CreateMessageResult)
        return said(f"LLM response: {getattr(found.content, 'text', '')}")

    async def _elicitation(self, ctx: Context, params: Params) -> Outcome:
        words = (params.arguments or {})["message"]
        fields = {"username": _TEXT, "email": _TEXT}
        return await _elicit(ctx, form(words, fields, ["username", "email"]), "User response:")

    async def _defaults(self, ctx: Context, params: Params) -> Outcome:
        fields = {
            "name": {"type": "string", "default": "John Doe"},
            "age": {"type": "integer", "default": 30},
            "score": {"type": "number", "default": 95.5},
            "status": {
                "type": "string",
                "enum": ["active", "inactive", "pending"],
                "default": "active",
            },
            "verified": {"type": "boolean", "default": True},
        }
        return await _elicit(ctx, form("Defaults", fields, []), "Elicitation completed:")

    async def _enums(self, ctx: Context, params: Params) -> Outcome:
        plain = ["option1", "option2", "option3"]
        titled = [
            {"const": f"value{n}", "title": f"{word} Option"}
            for n, word in enumerate(("First", "Second", "Third"), 1)
        ]
        fields: dict[str, Any] = {
            "untitledSingle": {"type": "string", "enum": plain},
            "titledSingle": {"type": "string", "oneOf": titled},
            "legacyEnum": {
                "type": "string",
                "enum": ["opt1", "opt2", "opt3"],
                "enumNames": ["Option One", "Option Two", "Option Three"],
            },
            "untitledMulti": {"type": "array", "items": {"type": "string", "enum": plain}},
            "titledMulti": {"type": "array", "items": {"anyOf": titled}},
        }
        return await _elicit(ctx, form("Enums", fields, []), "Elicitation completed:")

    async def _reconnection(self, ctx: Context, params: Params) -> Outcome:
        if ctx.close_sse_stream is not None:
            await ctx.close_sse_stream()
        await asyncio.sleep(0.1)
        return said("Reconnection test completed successfully.")

    async def _changed(self, ctx: Context, params: Params) -> Outcome:
        self._change()
        return said("Changed.")

    # -- questions to the client, 2026-07-28 ---------------------------------------------------

    async def _missing(self, ctx: Context, params: Params) -> Outcome:
        capabilities = ctx.session.client_capabilities
        if capabilities is None or capabilities.sampling is None:
            raise MCPError(
                types.MISSING_REQUIRED_CLIENT_CAPABILITY,
                "sampling is needed",
                {"requiredCapabilities": {"sampling": {}}},
            )
        return said("It is there.")

    async def _elicited(self, ctx: Context, params: Params) -> Outcome:
        name = accepted(params, "user_name", "name")
        if not isinstance(name, str):
            return asking({"user_name": NAME})
        return said(f"Hello, {name}!")

    async def _sampled(self, ctx: Context, params: Params) -> Outcome:
        given = answers(params).get("capital_question")
        if given is None:
            return asking({"capital_question": question("What is the capital of France?", 100)})
        return said(str(given["content"]["text"]))

    async def _rooted(self, ctx: Context, params: Params) -> Outcome:
        given = answers(params).get("client_roots")
        if given is None:
            return asking({"client_roots": types.ListRootsRequest()})
        return said(json.dumps(given["roots"]))

    async def _state(self, ctx: Context, params: Params) -> Outcome:
        if params.request_state != "confirming" or accepted(params, "confirm", "ok") is None:
            return asking({"confirm": CONFIRM}, "confirming")
        return said("state-ok")

    async def _multiple(self, ctx: Context, params: Params) -> Outcome:
        if {"user_name", "greeting", "client_roots"} <= answers(params).keys():
            return said("All there.")
        return asking(
            {
                "user_name": NAME,
                "greeting": question("Generate a greeting", 50),
                "client_roots": types.ListRootsRequest(),
            },
            "several",
        )

    async def _rounds(self, ctx: Context, params: Params) -> Outcome:
        if params.request_state == "second" and "step2" in answers(params):
            return said("Three rounds.")
        if params.request_state == "first" and "step1" in answers(params):
            colour = form("Step 2: What is your favorite color?", {"color": _TEXT}, ["color"])
            return asking({"step2": colour}, "second")
        name = form("Step 1: What is your name?", {"name": _TEXT}, ["name"])
        return asking({"step1": name}, "first")

    async def _capable(self, ctx: Context, params: Params) -> Outcome:
        capabilities = ctx.session.client_capabilities
        requests: dict[str, Any] = {}
        if capabilities is not None and capabilities.elicitation is not None:
            requests["user_name"] = NAME
        if capabilities is not None and capabilities.sampling is not None:
            requests["greeting"] = question("Generate a greeting", 50)
        return asking(requests, "capable")

    # -- resources and prompts -----------------------------------------------------------------

    async def resources(self, ctx: Context) -> Sequence[types.Resource]:
        return [
            types.Resource(uri=f"test://{name}", name=name, description=f"Fixture {name}.")
            for name in ("static-text", "static-binary", "watched-resource")
        ]

    async def templates(self, ctx: Context) -> Sequence[types.ResourceTemplate]:
        return [types.ResourceTemplate(uri_template="test://template/{id}/data", name="template")]

    async def read(
        self, ctx: Context, params: types.ReadResourceRequestParams
    ) -> types.ReadResourceResult | None:
        uri, text = params.uri, ""
        if uri == "test://static-binary":
            blob = types.BlobResourceContents(uri=uri, mime_type="image/png", blob=PNG)
            return types.ReadResourceResult(contents=[blob])
        media = "text/plain"
        if uri == "test://static-text":
            text = "This is the content of the static text resource."
        elif uri == "test://watched-resource":
            text = "Watched."
        elif uri.startswith("test://template/"):
            id_ = uri.split("/")[3]
            media = "application/json"
            text = json.dumps({"id": id_, "templateTest": True, "data": f"Data for ID: {id_}"})
        else:
            return None
        found = types.TextResourceContents(uri=uri, mime_type=media, text=text)
        return types.ReadResourceResult(contents=[found])

    async def prompts(self, ctx: Context) -> Sequence[types.Prompt]:
        def prompt(name: str, *arguments: str) -> types.Prompt:
            taken = [types.PromptArgument(name=one, required=True) for one in arguments]
            return types.Prompt(name=name, description=f"Fixture {name}.", arguments=taken)

        return [
            prompt("test_simple_prompt"),
            prompt("test_prompt_with_arguments", "arg1", "arg2"),
            prompt("test_prompt_with_embedded_resource", "resourceUri"),
            prompt("test_prompt_with_image"),
            prompt("test_input_required_result_prompt"),
        ]

    async def prompt(
        self, ctx: Context, params: types.GetPromptRequestParams
    ) -> types.GetPromptResult | types.InputRequiredResult | None:
        given = params.arguments or {}
        match params.name:
            case "test_simple_prompt":
                return _messages("This is a simple prompt for testing.")
            case "test_prompt_with_arguments":
                one, two = given["arg1"], given["arg2"]
                return _messages(f"Prompt with arguments: arg1='{one}', arg2='{two}'")
            case "test_prompt_with_embedded_resource":
                text = "Embedded resource content for testing."
                embedded = _resource(given["resourceUri"], text)
                return _messages(embedded, "Please process the embedded resource above.")
            case "test_prompt_with_image":
                image = types.ImageContent(type="image", data=PNG, mime_type="image/png")
                return _messages(image, "Please analyze the image above.")
            case "test_input_required_result_prompt":
                found = accepted(params, "user_context", "context")
                if found is None:
                    words = "What context should the prompt use?"
                    return asking({"user_context": form(words, {"context": _TEXT}, ["context"])})
                return _messages(f"Context: {found}")
            case _:
                return None

    async def complete(
        self, ctx: Context, params: types.CompleteRequestParams
    ) -> types.Completion | None:
        return types.Completion(values=["paris", "park", "party"], total=150, has_more=True)


def _with(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": [*properties]}


def _resource(uri: str, text: str, media: str = "text/plain") -> types.EmbeddedResource:
    contents = types.TextResourceContents(uri=uri, mime_type=media, text=text)
    return types.EmbeddedResource(type="resource", resource=contents)


def _messages(*parts: Any) -> types.GetPromptResult:
    content = [types.TextContent(type="text", text=p) if isinstance(p, str) else p for p in parts]
    return types.GetPromptResult(
        messages=[types.PromptMessage(role="user", content=one) for one in content]
    )


async def _ask(ctx: Context, request: Any, result: Any) -> Any:
    """Ask a client of an older version."""
    if modern(ctx):
        raise MCPError(types.INVALID_REQUEST, "there is no way back to the client")
    from mcp.shared.message import ServerMessageMetadata

    metadata = ServerMessageMetadata(related_request_id=ctx.request_id)
    return await ctx.session.send_request(request, result, metadata=metadata)


async def _elicit(ctx: Context, request: types.ElicitRequest, head: str) -> Outcome:
    found: types.ElicitResult = await _ask(ctx, request, types.ElicitResult)
    return said(f"{head} action={found.action}, content={json.dumps(found.content)}")
