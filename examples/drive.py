"""Drive for a while, then stop sending: the gateway's dead-man brings the robot to rest.

Run it as `python examples/drive.py --speed 0.4 --seconds 2`.

Each write is valid for half a second. If this program is killed, the robot stops after that time.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit


def call(url: str, token: str, method: str, path: str, body: Any = None) -> dict[str, Any]:
    """Make one call and return its reply envelope, whatever the status."""
    data = None if body is None else json.dumps(body).encode()
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    request = urllib.request.Request(url + path, data, headers, method=method)  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:  # noqa: S310 - as given
            return json.load(answer)
    except urllib.error.HTTPError as error:
        return json.load(error)


def demo_token(url: str) -> str | None:
    """Return the key that `rcpd demo` stores for programs of the same user."""
    base = os.environ.get("XDG_RUNTIME_DIR") or Path.home() / ".cache"
    path = Path(base) / "rcp" / f"{urlsplit(url).netloc.replace(':', '_')}.token"
    return path.read_text(encoding="utf-8").strip() if path.is_file() else None


def main() -> None:
    """Drive, stop sending, and print the speed until the robot is at rest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default=os.environ.get("RCP_URL", "http://127.0.0.1:8080"))
    parser.add_argument("--token", default=os.environ.get("RCP_TOKEN"))
    parser.add_argument("--tenant", default="alpha")
    parser.add_argument("--speed", type=float, default=0.4, help="m/s")
    parser.add_argument("--seconds", type=float, default=2.0)
    args = parser.parse_args()
    token = args.token or demo_token(args.url)
    if token is None:
        sys.exit("Moving a robot requires a key: pass --token or set RCP_TOKEN.")
    drive = f"/rcp/v1/context/tenant/{args.tenant}/actuator/cmd_vel?valid_for=0.5"
    speed = f"/rcp/v1/context/tenant/{args.tenant}/sensor/odometry?fields=twist.linear.x"
    end = time.monotonic() + args.seconds
    while time.monotonic() < end:
        reply = call(args.url, token, "PUT", drive, {"linear": {"x": args.speed}})
        if reply["status"] != "completed":
            error = reply["error"]
            sys.exit(f"{error['code']}: {error['message']} {error['remedy']}")
        time.sleep(0.2)
    print("no more commands")
    for _ in range(15):
        now = call(args.url, token, "GET", speed)["body"]["twist"]["linear"]["x"]
        print(f"{now:6.3f} m/s", flush=True)
        time.sleep(0.1)


if __name__ == "__main__":
    main()
