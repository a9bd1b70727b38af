"""`rcpd demo`: two tenants with a rover each, others with a drone, motors and robots with physics, keys made for this run, and where to look."""

from __future__ import annotations

import os
import secrets
import shutil
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from rcp_gateway.plugins import installed
from rcp_gateway.server import Server
from rcpd.installed import obstacle

__all__ = ["Demo", "token_file"]

_CONFIG = """
name = "rcp-demo"

[transports.asgi]
port = {port}

[plugins.dashboard]

[plugins.foxglove]

[plugins.rosbridge]
{a2a}{mcp}
[log]
level = "{level}"

# All robots are simulated: a computer that is busy for a moment need not stop them.
[safety]
guard_after = 5.0

[features.frames.anchors]
"/tenant/alpha" = {{ latitude = -35.3632, longitude = 149.1653, altitude = 584 }}
"/tenant/beta" = {{ latitude = -35.3631, longitude = 149.1654, altitude = 584 }}

[features.places.given.box]
description = "Square box in the hall of the rovers, north-west of its middle."
position = {{ latitude = -35.3631369, longitude = 149.1652119 }}
radius = 0.45

[[backends]]
use = "sim"
name = "rover-alpha"
tenant = "alpha"
seed = 1

[[backends]]
use = "sim"
name = "rover-beta"
tenant = "beta"
seed = 2
{drone}{head}{physics}
[[keys]]
name = "demo-operator"
role = "operator"
key = "{operator}"

[[keys]]
name = "demo-admin"
role = "admin"
key = "{admin}"
"""

_A2A = """
[plugins.a2a.push]
http = true
private = ["127.0.0.0/8", "::1/128"]
"""

_MCP = """
[plugins.mcp]
"""

_DRONE = """
[[backends]]
use = "mavlink"
name = "drone-gamma"
tenant = "gamma"
links = ["sim:copter"]
twin = { warmup = 2, boxes = [{ latitude = -35.3631369, longitude = 149.1652119, side = 0.6, height = 1.8 }] }
"""

_HEAD = """
[[backends]]
use = "can"
name = "head-delta"
tenant = "delta"

[backends.buses.can0]
interface = "virtual"
channel = "rcp-demo"
bitrate = 1_000_000
simulate = true

[backends.motors.pan]
bus = "can0"
profile = "odrive"
node = 1
gear = 8.0
position = [-2.8, 2.8]
velocity = 3.0
torque = 4.0
acceleration = 12.0

[backends.motors.tilt]
bus = "can0"
profile = "cia402"
node = 2
gear = 20.0
position = [-0.8, 1.2]
velocity = 2.0
torque = 8.0
acceleration = 8.0
options = { rated_torque = 0.5 }

[backends.joint_groups.head]
joints = ["pan", "tilt"]
"""


_PHYSICS = """
[[backends]]
use = "mujoco"
name = "rover-epsilon"
tenant = "epsilon"
model = "rover"

[[backends]]
use = "mujoco"
name = "arm-zeta"
tenant = "zeta"
model = "arm"
"""


def token_file(host: str, port: int) -> Path:
    """Return the file with the demo's key for `rcpctl` of the same user."""
    base = os.environ.get("XDG_RUNTIME_DIR") or str(Path.home() / ".cache")
    return Path(base) / "rcp" / f"{host}_{port}.token"


def _usable(group: str, name: str) -> bool:
    """Return whether a plugin is installed with its libraries."""
    point = installed(group).get(name)
    return point is not None and obstacle(point) is None


class Demo:
    """The demo's configuration and banner."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._operator = "rcp_op_" + secrets.token_urlsafe(18)
        self._admin = "rcp_ad_" + secrets.token_urlsafe(18)
        self._a2a, self._mcp = _usable("plugins", "a2a"), _usable("plugins", "mcp")
        self._drone, self._head = _usable("backends", "mavlink"), _usable("backends", "can")
        self._physics = _usable("backends", "mujoco")

    def config(self, level: str) -> str:
        """Return the configuration as TOML."""
        return _CONFIG.format(
            port=self._port,
            level=level,
            operator=self._operator,
            admin=self._admin,
            a2a=_A2A if self._a2a else "",
            mcp=_MCP if self._mcp else "",
            drone=_DRONE if self._drone else "",
            head=_HEAD if self._head else "",
            physics=_PHYSICS if self._physics else "",
        )

    def url(self, server: Server) -> str:
        """Return the actual address of the listener."""
        found = [facts["url"] for facts in server.status.transports if "url" in facts]
        return found[0] if found else f"http://127.0.0.1:{self._port}"

    @contextmanager
    def credentials(self, server: Server) -> Generator[None]:
        """Store the operator's key for `rcpctl` of the same user while the demo runs."""
        host, _, port = self.url(server).rpartition("/")[2].partition(":")
        path = token_file(host, int(port or 80))
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "w") as file:
                file.write(self._operator + "\n")
        except OSError:
            yield
            return
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()

    def banner(self, server: Server) -> str:
        """Return what is running, and commands to try first."""
        url = self.url(server)
        beside = Path(sys.argv[0]).with_name("rcpctl")
        rcpctl = "rcpctl" if shutil.which("rcpctl") or not beside.exists() else beside
        where = "simulated rovers in the tenants alpha and beta"
        fly = "  To add a drone: pip install 'rcp-gateway[mavlink]'"
        if self._drone:
            where += ", a drone in gamma"
            does = f"  {rcpctl} --url {url} execute /tenant/gamma/action"
            fly = f"{does}/arm\n{does}/takeoff\n{does}/land"
        motors = "  To add CAN motors: pip install 'rcp-gateway[can]'"
        if self._head:
            where += ", a head with two motors in delta"
            does = f"  {rcpctl} --url {url} execute /tenant/delta"
            goal = """'{"positions": {"pan": 1, "tilt": 0.5}}'"""
            motors = f"{does}/service/head/enable\n{does}/action/head/move_joints {goal}"
        physics = "  To add robots with physics: pip install 'rcp-gateway[mujoco]'"
        if self._physics:
            where += ", a rover and an arm with physics in epsilon and zeta"
            does = f"  {rcpctl} --url {url} execute /tenant"
            goal = """'{"position": {"x": 0.4, "y": 0.2, "z": 0.3}}'"""
            drive = """'{"position": {"x": 1, "y": 1}}'"""
            physics = f"{does}/epsilon/action/move_to {drive}\n{does}/zeta/action/move_tool {goal}"
        a2a = f"{url}/a2a               A2A, for other agents"
        if not self._a2a:
            a2a = "To add A2A: pip install 'rcp-gateway[a2a]'"
        mcp = f"{url}/mcp               MCP, for AI models"
        if not self._mcp:
            mcp = "To add MCP: pip install 'rcp-gateway[mcp]'"
        socket = url.replace("http", "ws", 1)
        return f"""\
RCP gateway demo: {where}
  {url}/                  dashboard (open in a browser)
  {url}/rcp/v1/discovery  all resources
  {url}/metrics           Prometheus metrics
  {a2a}
  {mcp}
  {socket}/foxglove            for Foxglove and Lichtblick
  {socket}/rosbridge           for web pages and scripts of ROS robots

  operator key  {self._operator}   (reads, writes, commands)
  admin key     {self._admin}   (as operator; also resets an e-stop:
                {rcpctl} --url {url} --token {self._admin} estop --reset)
  Without a key you can read but not move anything. Enter one under "Log in" on the dashboard;
  rcpctl finds the operator key by itself.

Try:
  {rcpctl} --url {url} read /tenant/alpha/sensor/pose
  {rcpctl} --url {url} execute /tenant/beta/action/move_to '{{"position": {{"x": 2, "y": 1, "z": 0}}}}'
{fly}
{motors}
{physics}
  curl {url}/rcp/v1/context/tenant/alpha/sensor/pose
  curl -X PUT -H "Authorization: Bearer {self._operator}" -d 0.8 {url}/rcp/v1/context/tenant/alpha/param/speed_limit
  curl -N "{url}/rcp/v1/events?path=/tenant/*/sensor/pose&rate=2"
Ready. Press Ctrl-C to stop."""
