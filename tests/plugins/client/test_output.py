"""What people are shown."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from typing import Any

import pytest

from rcp_client.console.fleet import fleet
from rcp_client.console.outline import outline
from rcp_client.console.output import Output, clean, compact, exit_code, pretty
from rcp_client.console.show import status
from rcp_client.errors import ConnectionLost, unknown_outcome
from rcp_kernel.errors import Cancelled, DeviceTimeout, Forbidden, OutOfRange


def test_short_values_stay_in_one_line() -> None:
    assert pretty({"x": 1.23456789, "y": [1, 2]}) == '{"x": 1.23457, "y": [1, 2]}'


def test_long_values_are_laid_out_and_bytes_counted() -> None:
    value = {"name": "n" * 60, "ranges": list(range(40)), "data": b"x" * 1000, "empty": {}}
    text = pretty(value)
    assert json.loads(text)["data"] == "<1000 bytes>"
    assert json.loads(text)["ranges"] == list(range(40))
    assert all(len(line) <= 90 for line in text.splitlines())


def test_a_warning_of_the_status_tells_its_facts(capsys: pytest.CaptureFixture[str]) -> None:
    facts = {"backend": "head", "error": "no\x1b feedback"}
    record = {"timestamp": "T", "level": "warning", "message": "halt_failed", "facts": facts}
    status(Output("table"), {"state": "ok", "warnings": [record, {**record, "facts": None}]})
    *_, first, second = capsys.readouterr().out.splitlines()
    assert first == "T warning: halt_failed backend=head error=no� feedback"
    assert second == "T warning: halt_failed"


def test_long_texts_and_lists_are_cut() -> None:
    assert "<500 characters>" in compact("t" * 500)
    assert json.loads(compact(list(range(100))))[-1] == "<100 items>"


def test_nothing_shown_commands_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert clean("a\x1b]0;owned\x07b\x9bc") == "a�]0;owned�b�c"
    assert "\x1b" not in compact({"a\x1b": "b\x1b"})
    out = Output("table")
    out.table(("A",), [("x\x1b[2J",)])
    out.aside("y\x1b[2J")
    shown = capsys.readouterr()
    assert "\x1b" not in shown.out + shown.err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (OutOfRange("m"), 3),
        (Forbidden("m"), 3),
        (DeviceTimeout("m"), 1),
        (Cancelled("m"), 1),
        (ConnectionLost("m"), 4),
        (unknown_outcome(ConnectionLost("m")), 1),
    ],
)
def test_each_error_has_its_exit_status(error: Exception, code: int) -> None:
    assert exit_code(error) == code


def test_a_schema_is_one_line_for_each_field() -> None:
    point = {
        "type": "object",
        "properties": {
            "x": {"type": "number", "unit": "m", "minimum": 0, "maximum": 5},
            "mode": {"enum": ["a", "b"], "default": "a", "description": "How."},
            "next": {"anyOf": [{"$ref": "#/$defs/Point"}, {"type": "null"}]},
        },
        "required": ["x"],
    }
    schema = {
        "type": "object",
        "properties": {
            "at": {"$ref": "#/$defs/Point"},
            "path": {"type": "array", "items": {"type": "number", "unit": "m"}},
            "data": {"type": "string", "contentEncoding": "base64"},
        },
        "$defs": {"Point": point},
    }
    rows = {name: (type_, note) for name, type_, note in outline(schema)}
    assert rows["at.x"] == ("number, ≥ 0 ≤ 5, m, required", "")
    assert rows["at.mode"] == ('one of a b, default "a"', "How.")
    assert rows["path"] == ("list of number in m", "")
    assert rows["data"] == ("bytes", "")
    assert max(name.count(".") for name in rows) <= 7


class _LaterHub:
    """What a hub of a later version says of its links."""

    _STATES = ("ready", "asleep", None, "down")

    async def discover(self, *_: Any, **__: Any) -> list[Any]:
        return [_Link(f"/tenant/a/sensor/r{num}/link") for num in range(len(self._STATES))]

    async def pages(self, _: str) -> AsyncGenerator[list[dict[str, Any]]]:
        bodies = [{} if state is None else {"state": state} for state in self._STATES]
        yield [
            {"path": f"/tenant/a/sensor/r{num}/link", "status": "completed", "body": body}
            for num, body in enumerate(bodies)
        ]


class _Link:
    schema_ids = {"value": "GatewayLink.1"}  # noqa: RUF012 - never changed

    def __init__(self, path: str) -> None:
        self.path = path


@pytest.mark.anyio
@pytest.mark.parametrize("as_json", [True, False])
async def test_links_in_unknown_states_are_listed_first(
    capsys: pytest.CaptureFixture[str], *, as_json: bool
) -> None:
    hub: Any = _LaterHub()
    assert await fleet(hub, Output("json" if as_json else "table"), {}) == 0
    shown = capsys.readouterr().out
    if as_json:
        states = [json.loads(line)["state"] for line in shown.splitlines()]
        assert states == ["asleep", "unknown", "down", "ready"]
    else:
        assert "r1 is asleep" in shown
