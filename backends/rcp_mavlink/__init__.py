"""MAVLink vehicles: drones, planes, rovers and boats; `rcp_mavlink_sim` simulates them.

`reception.py` leads from a message to samples, `actions.py` from an action to bytes; `robot.py` has the
parts of one vehicle. Importing this package is cheap; pymavlink is imported when a backend is opened.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.errors import ConfigError
from rcp_kernel.spi import BackendKind, Exclusive
from rcp_mavlink.backend import MavlinkBackend, open_mavlink
from rcp_mavlink.config import LinkSpec, MavlinkConfig, TwinConfig
from rcp_protocol.similarity import closest

__all__ = ["MavlinkBackend", "MavlinkConfig", "TwinConfig", "open_mavlink", "rcp_backends"]


def _check(config: MavlinkConfig) -> None:
    name = config.dialect
    if name.endswith(".xml"):
        return
    if not name.isidentifier() or find_spec(f"pymavlink.dialects.v20.{name}") is None:
        known = [one.name for one in iter_modules(import_module("pymavlink.dialects.v20").__path__)]
        near = closest(name, known)
        advice = f"did you mean '{near}'?" if near else f"it has {', '.join(sorted(known))}"
        raise ConfigError(f"`dialect`: pymavlink has no '{name}'; {advice}")


def _lacks(config: MavlinkConfig) -> str | None:
    name = config.dialect
    if not name.endswith(".xml") or Path(name).is_file():
        return None
    return f"`dialect`: there is no file '{name}'"


def _exclusive(config: MavlinkConfig) -> Iterator[Exclusive]:
    for text in config.links:
        link = LinkSpec.of(text)
        if link.kind == "serial":
            yield Exclusive(text, link.host)
        elif link.kind in ("udpin", "tcpin") and link.port:
            yield Exclusive(text, f"{link.kind} {link.port}", _address(link))


def _address(link: LinkSpec) -> str:
    """Return the address that a link listens at, as far as it is known without a name service."""
    if link.host.lower() == "localhost":  # every resolver has it
        return "127.0.0.1"
    # For TCP asyncio opens `::` for IPv6 alone (IPV6_V6ONLY), for UDP it takes IPv4 as well.
    return "*" if link.kind == "udpin" and link.host == "::" else link.host


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Connect MAVLink vehicles."""
    text, needs = "MAVLink vehicles.", ("pymavlink", "fastcrc")
    kind = BackendKind(
        "mavlink",
        MavlinkConfig,
        open_mavlink,
        text,
        needs,
        _check,
        exclusive=_exclusive,
        lacks=_lacks,
    )
    return [kind]
