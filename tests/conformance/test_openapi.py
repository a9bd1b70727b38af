"""Whatever the OpenAPI document allows is served as the document says, and never with a 500."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import msgspec

from conformance.wires import LISTENER, address
from rcp_kernel.config.file import BackendConfig, GatewayConfig
from rcp_kernel.testing import OPERATOR, serve
from rcp_kernel.testing.wire import DEAD, ROBOT, configuration

BOUND = 150  # s, on a slow machine
CHECKS = (
    *("not_a_server_error", "status_code_conformance", "content_type_conformance"),
    *("response_headers_conformance", "response_schema_conformance"),
)
# What the contract says of robots that fail, are away or late; 500 is not among it.
SETTINGS = """
[checks.not_a_server_error]
expected-statuses = ["2xx", "3xx", "4xx", 501, 502, 503, 504]
"""
# Endless; fails by design; stops the rest; of a type within itself, which takes the tool hours.
LEFT_OUT = "(/events|/sensor/crashed|/system/estop|/system/plans)$"


def served() -> GatewayConfig:
    """Return a gateway with a rover beside the robots of the wire suite, and little patience."""
    config = configuration({"asgi": LISTENER, "http": {}, "sse": {}})
    options = {"world": "empty", "map_resolution": 0.5, "rate": 20}
    rover = BackendConfig(use="sim", name="rover", tenant="alpha", robot="rover", options=options)
    limits = msgspec.structs.replace(config.limits, deadline=0.2)
    return msgspec.structs.replace(config, backends=(*config.backends, rover), limits=limits)


async def test_the_document_holds(tmp_path: Path) -> None:
    settings = tmp_path / "schemathesis.toml"
    settings.write_text(SETTINGS)
    async with serve(served(), ROBOT, DEAD) as gateway:
        url = address(gateway.server)
        program = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "schemathesis.cli", "--config-file", str(settings), "run"),
            *(f"{url}/openapi.json", "--header", f"Authorization: Bearer {OPERATOR}"),
            *("--checks", ",".join(CHECKS), "--exclude-path-regex", LEFT_OUT),
            *("--phases", "examples,coverage,fuzzing", "--max-examples", "3"),
            *("--workers", "2", "--generation-deterministic", "--no-color"),
            *("--request-timeout", "5", "--suppress-health-check", "all"),
            cwd=tmp_path,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        try:
            async with asyncio.timeout(BOUND):
                told, _ = await program.communicate()
        finally:
            if program.returncode is None:
                program.kill()
                await program.wait()
        assert program.returncode == 0, told.decode()[-8000:]
        alive = (await gateway.client(OPERATOR).request("status"))["body"]
        assert alive["backends"][0]["state"] == "ready"
