"""Print a robot's pose as it moves, using only the standard library (Server-Sent Events).

python examples/stream_pose.py --rate 2
"""

from __future__ import annotations

import argparse
import json
import os
import urllib.parse
import urllib.request
from collections.abc import Iterator
from typing import Any


def updates(url: str, path: str, rate: float, token: str | None) -> Iterator[dict[str, Any]]:
    """Yield the updates of a path as they arrive."""
    query = urllib.parse.urlencode({"path": path, "rate": rate})
    request = urllib.request.Request(f"{url}/rcp/v1/events?{query}")  # noqa: S310 - as given
    if token:
        request.add_header("Authorization", f"Bearer {token}")
    kind = "message"
    with urllib.request.urlopen(request, timeout=30) as lines:  # noqa: S310
        for line in lines:
            field, _, value = line.decode().rstrip("\n").partition(": ")
            if field == "event":
                kind = value
            elif field == "data" and kind == "update":
                yield json.loads(value)


def main() -> None:
    """Read the arguments and print poses."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default=os.environ.get("RCP_URL", "http://127.0.0.1:8080"))
    parser.add_argument("--token", default=os.environ.get("RCP_TOKEN"))
    parser.add_argument("--path", default="/tenant/alpha/sensor/pose")
    parser.add_argument("--rate", type=float, default=5.0, help="Hz")
    parser.add_argument("--count", type=int, help="stop after this many updates")
    args = parser.parse_args()
    for number, update in enumerate(updates(args.url, args.path, args.rate, args.token), 1):
        at = update["body"]["position"]
        print(f"{update['timestamp']}  x {at['x']:8.3f} m  y {at['y']:8.3f} m", flush=True)
        if number == args.count:
            return


if __name__ == "__main__":
    main()
