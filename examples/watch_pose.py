"""Watch one or more paths over a WebSocket, envelope by envelope (`pip install websockets`).

python examples/watch_pose.py '/tenant/*/sensor/pose' --rate 2
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os

from websockets.asyncio.client import connect


async def watch(url: str, path: str, rate: float, count: int | None, token: str | None) -> None:
    """Start the session, subscribe, and print each update."""
    address = url.replace("http", "ws", 1) + "/rcp/v1/ws"
    async with connect(address, subprotocols=["rcp.v1.json"]) as socket:  # pyright: ignore[reportArgumentType]
        hello = {"client": "watch_pose/1"} | ({"token": token} if token else {})
        await socket.send(json.dumps({"type": "hello", "id": "h", "body": hello}))
        body = {"rate": rate} | ({"count": count} if count else {})
        await socket.send(json.dumps({"type": "subscribe", "id": "s", "path": path, "body": body}))
        async for text in socket:
            message = json.loads(text)
            match message["type"]:
                case "update":
                    at = message["body"]["position"]
                    print(f"{message['path']}  x {at['x']:.3f} m  y {at['y']:.3f} m", flush=True)
                case "notice" if message["code"] == "subscription_ended":
                    return
                case _ if "error" in message:
                    raise SystemExit(message["error"]["message"])


def main() -> None:
    """Read the arguments and watch."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", nargs="?", default="/tenant/*/sensor/pose")
    parser.add_argument("--url", default=os.environ.get("RCP_URL", "http://127.0.0.1:8080"))
    parser.add_argument("--token", default=os.environ.get("RCP_TOKEN"))
    parser.add_argument("--rate", type=float, default=5.0, help="Hz, for each path")
    parser.add_argument("--count", type=int, help="stop after this many updates")
    args = parser.parse_args()
    asyncio.run(watch(args.url, args.path, args.rate, args.count, args.token))


if __name__ == "__main__":
    main()
