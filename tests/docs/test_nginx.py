"""The gateway behind nginx, configured as the page says: requests, streams and sockets pass, addresses are told."""

from __future__ import annotations

import asyncio
import socket
import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import Request, urlopen

import rcp_client
from configuration import backend, key, listener
from docs.blocks import BLOCKS
from ports import free_port
from programs import program
from rcp_gateway.testing import eventually
from serving import serving

KEY = "operator-operator"
_BLOCK = next(block.text for block in BLOCKS if block.language == "nginx")
_WHOLE = """
daemon off;
master_process off;
pid {folder}/pid;
error_log stderr;
events {{}}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    {block}
}}
"""


@contextmanager
def proxy(folder: Path, gateway: str) -> Generator[str]:
    """Run nginx with the page's block before a gateway; yield its address."""
    port = free_port()
    block = _BLOCK.replace("http://127.0.0.1:8080", gateway).replace(
        "listen 443 ssl;", f"listen 127.0.0.1:{port};"
    )
    lines = [line for line in block.splitlines() if "ssl_certificate" not in line]
    file = folder / "nginx.conf"
    file.write_text(_WHOLE.format(folder=folder, block="\n".join(lines)))
    command = [program("nginx"), "-p", str(folder), "-c", str(file), "-e", "stderr"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield f"http://127.0.0.1:{port}"
        finally:
            process.terminate()
            process.communicate(timeout=60)


async def listens(url: str) -> bool:
    host, _, port = url.removeprefix("http://").partition(":")
    with socket.socket() as made:
        return made.connect_ex((host, int(port))) == 0


async def test_a_robot_is_driven_through_nginx(tmp_path: Path) -> None:
    text = listener(proxies=["127.0.0.1"]) + backend("rover", use="sim") + key("operator", KEY)
    with serving(tmp_path / "rcp.toml", text) as gateway, proxy(tmp_path, gateway) as url:
        await eventually(lambda: listens(url), "nginx listens", 40)
        async with rcp_client.connect(url, token=KEY) as client:
            await client.execute("/action/move_to", {"position": {"x": 0.3, "y": 0.0}})
            async for update in client.subscribe("/sensor/pose", count=2):
                assert update.body["position"]["x"] > 0.1
        await asyncio.to_thread(stream_and_read, url)


def stream_and_read(url: str) -> None:
    bearer = {"Authorization": f"Bearer {KEY}"}
    stream = Request(f"{url}/rcp/v1/events?path=/tenant/alpha/sensor/pose", headers=bearer)
    with urlopen(stream, timeout=40) as events:  # one event comes before any buffer is full
        assert events.readline()
    pose = Request(f"{url}/rcp/v1/context/tenant/alpha/sensor/pose", headers=bearer)
    with urlopen(pose, timeout=40) as answer:
        assert answer.status == 200
