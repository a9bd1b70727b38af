"""Logins: what a browser has proved once, kept on the gateway and named by a cookie."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.role import Rule
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_logins.authenticator import LoginAuthenticator
from rcp_logins.config import LoginsConfig
from rcp_logins.directory import PATH, LoginDirectory
from rcp_logins.messages import Ended, Ending, ListedLogin
from rcp_web.logins import LOGINS

__all__ = ["LoginsConfig", "rcp_features"]

_RESOURCE = Resource(
    name="service/logins",
    description="Logins of browsers: your own, and those of the people whose sessions you may end; "
    "`execute` ends a login, or a session.",
    value=list[ListedLogin],
    input=Ending,
    output=Ended,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=({"login": "l-5f0c93aa"}, {"session": "s-3kd92f"}),
    history=1,
)
_OWN = Rule(("discover", "read", "subscribe", "execute"), (PATH,))


def _make(config: LoginsConfig, host: FeatureHost) -> Feature:
    logins = LoginAuthenticator(config, host)
    directory = LoginDirectory(logins, host)
    shown = SystemResource(resource=_RESOURCE, view=directory.view, execute=directory.end)
    return Feature(
        resources=(shown,),
        authenticator=logins,
        services={LOGINS: logins},
        reconfigure=logins.configure,
        running=logins.running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `logins`."""
    grants = {"viewer": (_OWN,), "operator": (_OWN,)}
    return [FeatureKind("logins", LoginsConfig, _make, __doc__ or "", grants=grants)]
