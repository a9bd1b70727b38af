"""A reverse proxy of few lines: it shows a gateway below a prefix, which it takes off."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing, suppress


@asynccontextmanager
async def below(prefix: str, port: int) -> AsyncGenerator[str]:
    """Serve the gateway at `port` below a prefix; yield the address."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError), closing(writer):
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
            method, path, rest = head.split(" ", 2)
            if not path.startswith(prefix + "/"):
                writer.write(b"HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n")
                return
            lines = rest.split("\r\n")
            if not any(line.lower().startswith("upgrade:") for line in lines):
                lines = [x for x in lines if not x.lower().startswith("connection:")]
                lines.insert(1, "Connection: close")  # a request each
            asked = " ".join((method, path[len(prefix) :], "\r\n".join(lines)))
            upstream, onward = await asyncio.open_connection("127.0.0.1", port)
            onward.write(asked.encode("latin-1"))
            await asyncio.gather(_pass(reader, onward), _pass(upstream, writer))

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}{prefix}"
    finally:
        server.close()


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(65_536):
            writer.write(data)
            await writer.drain()
    writer.close()
