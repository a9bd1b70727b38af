"""Sessions, with their connections, accounts and commands."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_kernel.app.composition.access import Access
from rcp_kernel.app.composition.base import Base
from rcp_kernel.app.composition.records import Records
from rcp_kernel.app.composition.safety import Safety
from rcp_kernel.app.composition.tree import Tree
from rcp_kernel.requests.command_access import CommandAccess
from rcp_kernel.sessions.accounting import SessionAccounting
from rcp_kernel.sessions.delegation import GatewayDelegation
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.streams.outbound import Outbound

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
        links=tree.links,
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
