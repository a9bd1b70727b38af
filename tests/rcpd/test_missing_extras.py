"""`rcpd check` tells of each library of each extra that a configuration needs and that is not installed."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import msgspec
import pytest

ROOT = Path(__file__).parents[2]
EXTRAS: dict[str, list[str]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
    "optional-dependencies"
]
CAN = """[[backends]]
use = "can" #!
tenant = "a"
[backends.buses.can0]
interface = "virtual"
simulate = true
"""
CASES = {
    "a2a": "[plugins.a2a] #!\n",
    "can": CAN,
    "conditions": """[[roles.driver.allow]]
operations = ["read"]
paths = ["/**"]
when = "sensor.battery.percentage > 0.2" #!
""",
    "configuration": "[features.configuration] #!\nsecret = '${file:key}'\n",
    "dronecan": f"""{CAN}[backends.motors.pan] #!
bus = "can0"
profile = "dronecan"
node = 1
velocity = 3.0
options = {{ index = 0 }}
""",
    "dashboard": "[plugins.dashboard] #!\n",
    "fleet": '[[backends]]\nuse = "fleet" #!\ntenant = "a"\n',
    "grpc": "[plugins.a2a] #!\n[plugins.a2a.grpc] #!\nport = 50051\n",
    "ground-stations": "[plugins.ground_stations] #!\n",
    "hubs": """[[hubs]] #!
name = "hub"
public_key = "fM1n0CmVgGzNO1yZf0gSMCc4x4vRLPUXOEI1GwYJdZo="
role = "viewer"
""",
    "jwt": """[[jwt]] #!
issuer = "https://issuer.example"
audience = "a"
jwks_url = "https://issuer.example/jwks"
role = "viewer"
""",
    "mavlink": '[[backends]]\nuse = "mavlink" #!\ntenant = "a"\nlinks = ["udpin:127.0.0.1:14550"]\n',
    "mcp": "[plugins.mcp] #!\n",
    "mujoco": '[[backends]]\nuse = "mujoco" #!\ntenant = "a"\nmodel = "robot.xml"\n',
    "replay": '[[backends]]\nuse = "replay" #!\ntenant = "a"\nfile = "a.mcap"\n',
    "recorder": '[features.recorder] #!\nfolder = "recordings"\n',
    "ros2": '[[backends]]\nuse = "ros2" #!\ntenant = "a"\n',
    "tls": '[transports.asgi.tls] #!\ncertificate = "a.pem"\nkey = "a.key"\n',
    "tracing": '[features.tracing] #!\nendpoint = "http://127.0.0.1:4318"\n',
    "triggers": "[features.triggers] #!\n",
    "vda5050": '[plugins.vda5050] #!\nbroker = "mqtt://127.0.0.1:1883"\n',
    "zenoh": '[transports.zenoh] #!\nconnect = ["tcp/127.0.0.1:7447"]\ngateway = "a"\n',
}
NAMED_ELSEWHERE = {
    "all": "of the others",
    "test": "of the tests",
    "bench": "of the benchmarks",
    "console": "of rcpctl, which names it",
    "fast": "`rcpd serve` works without, and names it",
    "parquet": "a client asks for Parquet, and is told what the gateway lacks",
}
EXCUSED = re.compile(r"ros-(?!rclpy|rcl-interfaces)")
"""ROS messages: a topic whose type is not installed is told when a robot has it."""


def is_own(requirement: str) -> re.Match[str] | None:
    return re.match(r"rcp-gateway\[([\w-]+)\]", requirement)


def required(extra: str) -> set[str]:
    """Return the distributions of an extra, those of the extras in it too."""
    found: set[str] = set()
    for one in EXTRAS[extra]:
        inner = is_own(one)
        found |= required(inner[1]) if inner else {re.split(r"[\[<>=; ]", one)[0].lower()}
    return found


def modules_of(name: str) -> list[str]:
    """Return the module of an installed distribution that its name means."""
    if name in MEANT:
        return [MEANT[name]]
    try:
        files = [str(path) for path in distribution(name).files or ()]
    except PackageNotFoundError:
        return []
    tops = {path.split("/")[0] for path in files if path.endswith("/__init__.py")}
    tops |= {path.removesuffix(".py") for path in files if re.fullmatch(r"\w+\.py", path)}
    return sorted(top for top in tops if top.isidentifier())[:1]


MEANT = {
    "protobuf": "google.protobuf",
    "opentelemetry-exporter-otlp-proto-http": "opentelemetry.exporter.otlp.proto.http",
    "opentelemetry-sdk": "opentelemetry.sdk",
    "pyopengl": "OpenGL",
}


def test_every_extra_is_tried_or_said_to_be_named_elsewhere() -> None:
    assert set(CASES) | set(NAMED_ELSEWHERE) == set(EXTRAS)


@pytest.mark.parametrize("extra", CASES)
def test_each_missing_library_is_told_with_its_line_and_command(extra: str, tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(CASES[extra])
    modules = {
        module: name
        for name in sorted(required(extra))
        if not EXCUSED.match(name)
        for module in modules_of(name)
    }
    if not modules:
        pytest.skip(f"nothing of {extra} is installed here")
    program = Path(__file__).with_name("without_modules.py")
    done = subprocess.run(
        [sys.executable, program, file, *modules],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        cwd=tmp_path,
    )
    marked = [i for i, line in enumerate(CASES[extra].split("\n"), 1) if line.endswith("#!")]
    answers = done.stdout.split("\0")[:-1]
    assert len(answers) == len(modules), done.stderr
    for answer, (module, name) in zip(answers, modules.items(), strict=True):
        found = msgspec.json.decode(answer)
        told = [(one["line"], one["message"]) for one in found["faults"]]
        for text in found["warnings"]:
            line = re.match(rf"{re.escape(str(file))}:(\d+): ", text)
            told.append((int(line[1]) if line else 0, text))
        with_it = [one for one in EXTRAS if one in CASES and name in required(one)]
        commands = [f"pip install {name}", *(f"rcp-gateway[{one}]" for one in with_it)]
        named = [
            text
            for line, text in told
            if line in marked and f"'{module}'" in text and any(c in text for c in commands)
        ]
        assert named, (module, told, done.stderr)
