"""The layouts of users and tenants: listed, opened and changed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import to_builtins

from rcp_kernel.clock import iso
from rcp_kernel.errors import Forbidden, InvalidValue, PayloadTooLarge, UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_layouts.config import LayoutsConfig
from rcp_layouts.kept import KeptLayouts, Owner
from rcp_layouts.messages import EVERYONE, Entry, Layout, OwnRequest, SharedRequest

__all__ = ["PATH", "SHARED", "Layouts"]

PATH = "/system/layouts"
SHARED = "/system/shared_layouts"


class Layouts:
    """The layouts of a gateway."""

    def __init__(self, config: LayoutsConfig, host: FeatureHost) -> None:
        self._config = config
        self._host = host
        self._kept = KeptLayouts(host.store("layouts"))

    def configure(self, config: LayoutsConfig) -> None:
        """Apply other limits; what is there already stays."""
        self._config = config

    def restore(self) -> None:
        """Load what earlier runs have saved."""
        self._kept.restore()

    def own(self, session: Session) -> list[Any]:
        """List the reader's own layouts by name."""
        if session.principal.anonymous:
            return []
        return [to_builtins(one) for one in self._kept.listed(_user(session))]

    def shared(self, session: Session) -> Iterator[Any]:
        """List the layouts that the reader's tenants share."""
        for tenant in sorted(self._kept.tenants()):
            if self._sees(session, tenant):
                yield from (to_builtins(one) for one in self._kept.listed(Owner(tenant)))

    def change_own(
        self, session: Session, request: OwnRequest, *, dry_run: bool
    ) -> Layout | Entry | None:
        """Open a layout, or change one of the caller's own.

        :raises RcpError: there is none, it may not be seen, or the change is refused.
        """
        if request.do == "open" and request.tenant is not None:
            if not self._sees(session, request.tenant):
                raise UnknownPath(
                    f"there is no layout '{request.name}' of the tenant '{request.tenant}'",
                    path=SHARED,
                )
            return self._kept.get(Owner(request.tenant), request.name)
        if request.tenant is not None:
            raise InvalidValue(
                "a layout of one's own has no `tenant`",
                details={"pointer": "/tenant"},
                remedy=f"Leave `tenant` out, or execute {SHARED} to share the layout.",
            )
        if session.principal.anonymous:
            raise Forbidden(
                "layouts are kept for authenticated users only",
                path=PATH,
                remedy="Log in with a key or token.",
            )
        owner = _user(session)
        if request.do == "open":
            return self._kept.get(owner, request.name)
        return self._change(session, owner, request, PATH, dry_run=dry_run)

    def change_shared(
        self, session: Session, request: SharedRequest, *, dry_run: bool
    ) -> Entry | None:
        """Change a layout that a tenant shares.

        :raises RcpError: the session may not, or the change is refused.
        """
        tenant = request.tenant or session.tenant
        if tenant is None:
            raise InvalidValue(
                "a shared layout needs a `tenant`",
                details={"pointer": "/tenant"},
                remedy="Name a tenant, or `*` for a layout of all.",
            )
        held = session.rights.places(SHARED, Operation.EXECUTE)
        if EVERYONE not in held and tenant not in held:
            raise Forbidden(
                f"you may not share layouts with {'all' if tenant == EVERYONE else tenant}",
                path=SHARED,
                remedy="Ask for a role there that may execute it, or save the layout for yourself.",
            )
        return self._change(session, Owner(tenant), request, SHARED, dry_run=dry_run)

    def _sees(self, session: Session, tenant: str) -> bool:
        held = session.rights.places(SHARED, Operation.READ)
        return bool(held) and (tenant == EVERYONE or EVERYONE in held or tenant in held)

    def _change(
        self,
        session: Session,
        owner: Owner,
        request: OwnRequest | SharedRequest,
        path: str,
        *,
        dry_run: bool,
    ) -> Entry | None:
        config, tenant = self._config, owner.tenant or session.tenant or EVERYONE
        self._kept.check(owner, request.name, request.version)
        made = self._made(session, owner, request) if request.do == "save" else None
        if made is None:
            self._kept.get(owner, request.name)
        else:
            self._kept.check_room(owner, request.name, tenant, config.of_one, config.most)
        if dry_run:
            return None
        entry: Entry | None = None
        if made is None:
            self._kept.remove(owner, request.name)
        else:
            entry = self._kept.put(owner, made, tenant)
        if owner.tenant is not None:
            shared_with = None if owner.tenant == EVERYONE else owner.tenant
            self._host.note(
                "layout", principal=session.principal, session=session, path=path,
                tenant=shared_with, do=request.do, name=request.name,
            )  # fmt: skip
        self._host.changed(path)
        return entry

    def _made(self, session: Session, owner: Owner, request: OwnRequest | SharedRequest) -> Layout:
        if request.content is None:
            raise InvalidValue("`save` needs the `content`", details={"pointer": "/content"})
        size = len(msgspec.json.encode(request.content))
        if size > self._config.size:
            raise PayloadTooLarge(
                f"the layout has {size} bytes, and the limit is {self._config.size}",
                details={"limit": self._config.size},
                remedy="Remove panels or shorten notes.",
            )
        return Layout(
            name=request.name,
            tenant=owner.tenant,
            version=self._kept.following(owner, request.version),
            by=session.principal.name,
            saved=iso(self._host.clock.now()),
            content=request.content,
        )


def _user(session: Session) -> Owner:
    name, proof = session.principal.identity
    return Owner(None, name, proof)
