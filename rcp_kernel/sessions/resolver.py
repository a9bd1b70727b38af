"""Resolution of a path to its entry, with the check of rights: every request passes it."""

from __future__ import annotations

from rcp_kernel.errors import (
    AdapterUnavailable,
    BadRequest,
    Forbidden,
    RcpError,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.model import Operation, operation_names, parse_path
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry

__all__ = ["Resolver"]

_WHOLE = ("/tenant/", "/system/")
_AGAIN = 0.5  # s after which to retry a path that may appear


class Resolver:
    """Finds what requests name."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry

    def resolve(
        self, session: Session, path: str | None, operation: Operation, *, anyway: bool = False
    ) -> Entry:
        """Find the entry of a path and make sure that the session may do `operation` with it.

        `anyway`: conditions of the rules need not hold.

        :raises InvalidPath, UnknownPath, Forbidden, UnsupportedOperation: as they say.
        """
        if path is None:
            raise BadRequest("`path` is missing", remedy="Send `path` with the path of a resource.")
        # A hidden path must cost as much as a missing one: check the rights first.
        full = path if path.startswith(_WHOLE) else parse_path(path, session.tenant)
        rights = session.rights
        known = rights.masks.get(full)
        mask = known or rights.compute_mask(full)
        entry = self._registry.entries.get(full)
        if entry is None or not mask:
            parse_path(full, None)
            # By rights and place alone: a hidden path is answered like a missing one.
            if mask and self._registry.may_come(full):
                raise _not_yet(full)
            raise UnknownPath(f"no resource {full}", path=full)
        if not known:
            rights.remember(full, mask)
        # As integers: Python makes a new flag of each `&` of two, which costs more than all the rest.
        bits = int(operation)
        if not int(entry.operations) & bits:
            offered = operation_names(entry.operations)
            wanted = operation_names(operation)[0]
            raise UnsupportedOperation(
                f"{entry.path} does not offer `{wanted}`; it offers {', '.join(offered)}",
                path=entry.path,
                details={"allowed": offered},
            )
        if not mask & bits and not (anyway and rights.depends(entry, operation)):
            self.check(session, entry, operation)
        return entry

    def check(self, session: Session, entry: Entry, operation: Operation) -> None:
        """Refuse an operation that the rules do not allow as things are.

        :raises Forbidden: they do not.
        """
        rights = session.rights
        if rights.masks.get(entry.path, 0) & int(operation) or rights.permits(entry, operation):
            return
        wanted = operation_names(operation)[0]
        text = f"{session.principal.name} may not {wanted} {entry.path}"
        if not rights.depends(entry, operation):
            raise Forbidden(text, path=entry.path)
        blocking = rights.blocking_condition(entry, operation)
        if blocking is None or not rights.shows(blocking, entry):
            raise Forbidden(f"{text} at the moment", path=entry.path, remedy="Try again later.")
        raise Forbidden(
            f"{text} at the moment: the rule requires `{blocking.text}`",
            path=entry.path,
            remedy="Wait until the condition holds, or ask the operator to change the rule.",
            details={"condition": blocking.text},
        )


def _not_yet(path: str) -> RcpError:
    return AdapterUnavailable(
        f"no resource {path} yet: a robot that may have it is not connected",
        path=path,
        remedy="Send it again after `retry_after` seconds; `status` shows each backend.",
        retry_after=_AGAIN,
    )
