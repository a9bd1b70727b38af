"""Maintenance: a robot that somebody works on accepts no commands until the work is done."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, convert, to_builtins
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import ModeForbids, PreconditionFailed
from rcp_kernel.features import Call, Feature, FeatureHost, FeatureKind, Guard, Slot, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_kernel.sessions.session import Session
from rcp_kernel.types import Time

PATH = "/system/maintenance"
Name = Annotated[str, Meta(min_length=1, max_length=64)]


class MaintenanceConfig(Struct, frozen=True, forbid_unknown_fields=True):
    exempt: tuple[str, ...] = ()  # roles whose commands pass


class Request(Struct, frozen=True, forbid_unknown_fields=True):
    do: Literal["begin", "end"]
    robot: Name | None = None  # of the session's tenant; None: all of them
    reason: Annotated[str, Meta(max_length=200)] = ""


class Work(Struct, frozen=True):
    tenant: str
    robot: str | None
    by: str
    reason: str
    since: Time


class Maintenance(Guard):
    slot = Slot.POLICY

    def __init__(self, config: MaintenanceConfig, host: FeatureHost) -> None:
        self.config, self.host = config, host
        self.kept = host.store("work")
        self.work: dict[tuple[str, str | None], Work] = {}

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        found = [convert(one, Work) for one in self.kept.load().values()]
        self.work = {(one.tenant, one.robot): one for one in found}
        yield

    def reconfigure(self, config: MaintenanceConfig) -> None:
        self.config = config

    # -- the guard -----------------------------------------------------------------------------

    def admit(self, call: Call) -> None:
        tenant, robot = call.entry.tenant or "", call.entry.robot
        found = self.work.get((tenant, None)) or self.work.get((tenant, robot))
        if found is None or set(self.config.exempt) & set(call.session.principal.roles):
            return
        why = f": {found.reason}" if found.reason else ""
        raise ModeForbids(
            f"{found.by} has been working on this robot since {found.since}{why}",
            path=call.entry.path,
            remedy=f"Wait until the work is done: {PATH} shows it.",
        )

    def confirm(self, call: Call) -> None:
        self.admit(call)  # the work may have begun while the command waited

    # -- /system/maintenance -------------------------------------------------------------------

    def view(self, session: Session) -> list[Any]:
        tenants = session.principal.tenants
        return [to_builtins(w) for w in self.work.values() if {"*", w.tenant} & set(tenants)]

    def execute(self, session: Session, request: Request, *, dry_run: bool) -> Work | None:
        tenant, principal = session.tenant or "", session.principal
        key, work = (tenant, request.robot), self.work.get((tenant, request.robot))
        if request.do == "begin":
            work = Work(tenant, request.robot, principal.name, request.reason, iso(now()))
        elif work is None:
            raise PreconditionFailed("nobody works on this robot", path=PATH)
        if dry_run:
            return None
        if request.do == "begin":
            self.work[key] = work
        else:
            del self.work[key]
        self.kept.put(f"{tenant}/{request.robot or ''}", to_builtins(self.work.get(key)))
        note = {"do": request.do, "robot": request.robot, "reason": request.reason or None}
        self.host.note(
            "maintenance", principal=principal, session=session, tenant=tenant, path=PATH, **note
        )
        self.host.changed(PATH)
        return work


RESOURCE = Resource(
    name="service/maintenance",
    description="Robots in maintenance, which accept no commands: list, begin, end.",
    value=list[Work],
    input=Request,
    output=Work,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=({"do": "begin", "robot": "r1", "reason": "new gripper"},),
    history=1,
)


def make_maintenance(config: MaintenanceConfig, host: FeatureHost) -> Feature:
    made = Maintenance(config, host)
    return Feature(
        resources=(SystemResource(resource=RESOURCE, view=made.view, execute=made.execute),),
        guard=made,
        reconfigure=made.reconfigure,
        running=made.running,
    )


MAINTENANCE = FeatureKind("maintenance", MaintenanceConfig, make_maintenance, __doc__ or "")


@hookimpl
def rcp_features() -> list[FeatureKind]:
    return [MAINTENANCE]
