"""Sessions, with their connections, accounts and commands."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_gateway.composition.access import Access
from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.safety import Safety
from rcp_gateway.composition.tree import Tree
from rcp_kernel.sessions.accounting import SessionAccounting
from rcp_kernel.sessions.delegation import GatewayDelegation
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_requests.command_access import CommandAccess

__all__ = ["Clients", "compose_sessions"]


@dataclass(frozen=True, slots=True)
class Clients:
    """Sessions, and what they may still get."""

    outbound: Outbound
    accounting: SessionAccounting
    resume: SessionResume
    sessions: Sessions
    delegation: GatewayDelegation
    access: CommandAccess


def compose_sessions(
    base: Base, tree: Tree, access: Access, records: Records, safety: Safety
) -> Clients:
    """Create the sessions, of which there are none yet."""
    settings, loop, identities = base.settings, base.loop, access.identities
    outbound = Outbound(loop, settings.limits)
    known: dict[str, Session] = {}
    accounting = SessionAccounting(known, records.journal.running)
    resume = SessionResume(records.store, settings, base.shutdown, loop, base.clock)
    sessions = Sessions(
        known,
        settings=settings,
        shutdown=base.shutdown,
        rules=access.rules,
        identities=identities,
        accounting=accounting,
        commands=safety.commands,
        resume=resume,
        events=records.events,
        outbound=outbound,
        loop=loop,
        clock=base.clock,
    )
    # What they may see is computed in steps from now on, so that a stop need not wait for it.
    for heard in (sessions.on_begin, sessions.on_renewal):
        heard.append(lambda session: tree.sights.look(session.rights))
    return Clients(
        outbound,
        accounting,
        resume,
        sessions,
        GatewayDelegation(identities, sessions),
        CommandAccess(records.journal, tree.visibility, identities),
    )
