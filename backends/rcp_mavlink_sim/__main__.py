"""`python -m rcp_mavlink_sim`: run a vehicle until interrupted."""

from __future__ import annotations

import argparse
import asyncio
import sys
from contextlib import AsyncExitStack, suppress
from hashlib import sha256

from rcp_mavlink_sim import Options, fly, vehicle_of
from rcp_mavlink_sim.kinds import KINDS
from rcp_mavlink_sim.parameters_table import settable


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m rcp_mavlink_sim",
        description="A simulated vehicle with ArduPilot or PX4 that speaks MAVLink 2.",
    )
    parser.add_argument(
        "--link",
        action="append",
        metavar="KIND:HOST:PORT",
        help="udpout (connect to a ground station), udpin or tcpin (listen for one); repeatable; "
        "default udpout:127.0.0.1:14550 and tcpin:127.0.0.1:5760",
    )
    parser.add_argument("--vehicle", choices=tuple(KINDS), default="copter")
    parser.add_argument(
        "--system", type=int, default=1, help="MAVLink system id of the first vehicle"
    )
    parser.add_argument(
        "--count", type=int, default=1, help="number of vehicles; they share udpout links only"
    )
    parser.add_argument(
        "--home", default="-35.3632621,149.1652374,584", help="lat,lon,height (deg, m)"
    )
    parser.add_argument("--heading", type=float, default=0.0, help="deg")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="simulated seconds per real second"
    )
    parser.add_argument(
        "--warmup", type=float, default=40.0, help="simulated seconds until it can be armed"
    )
    parser.add_argument("--wind", default="0,0", help="direction it blows towards, m/s north,east")
    parser.add_argument(
        "--charge", type=float, default=1.0, help="initial charge of the battery, 0 to 1"
    )
    parser.add_argument("--noise", type=float, default=1.0, help="scale of the sensor noise")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    parser.add_argument("--param", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--streaming", action="store_true", help="send telemetry without a request")
    parser.add_argument(
        "--latency", type=float, default=0.0, help="delay of everything it sends, s"
    )
    parser.add_argument("--key", help="passphrase for signing, as in ground stations")
    return parser.parse_args()


def _options(given: argparse.Namespace, number: int) -> Options:
    lat, lon, height = (float(part) for part in given.home.split(","))
    north, east = (float(part) for part in given.wind.split(","))
    parameters = dict(pair.split("=", 1) for pair in given.param)
    unknown = sorted(parameters.keys() - settable(given.vehicle))
    if unknown:
        sys.exit(f"it has no parameter {', '.join(unknown)}")
    return Options(
        vehicle=given.vehicle,
        system=given.system + number,
        home=(lat, lon + number * 5e-5, height),
        heading=given.heading,
        speed=given.speed,
        warmup=given.warmup,
        wind=(north, east),
        charge=given.charge,
        noise=given.noise,
        seed=given.seed + number,
        parameters={name: float(value) for name, value in parameters.items()},
        streaming=given.streaming,
        latency=given.latency,
        key=None if given.key is None else sha256(given.key.encode()).digest(),
    )


async def _run(given: argparse.Namespace) -> None:
    links = given.link or ["udpout:127.0.0.1:14550", "tcpin:127.0.0.1:5760"]
    async with AsyncExitStack() as stack:
        for number in range(given.count):
            own = links if number == 0 else [link for link in links if link.startswith("udpout")]
            twin = await stack.enter_async_context(fly(vehicle_of(_options(given, number)), *own))
            for link, (host, port) in zip(own, twin.ports, strict=True):
                print(f"vehicle {given.system + number} {link} from {host}:{port}", flush=True)  # noqa: T201
        await asyncio.Event().wait()


with suppress(KeyboardInterrupt):
    asyncio.run(_run(_arguments()))
