"""The principals of configured triggers: they have the roles that the configuration gives them."""

from __future__ import annotations

from collections.abc import Mapping

from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import Unauthenticated
from rcp_triggers.config import Rule

__all__ = ["RuleAuthenticator", "principal_of"]

_NAME = "triggers"


def principal_of(name: str, rule: Rule) -> Principal | None:
    """Return the principal that a configured trigger acts as; None if it sends no command."""
    if rule.run_as is None:
        return None
    return Principal(f"trigger {name}", rule.run_as.grants, f"{_NAME} {name}")


class RuleAuthenticator(Authenticator):
    """Takes no token: nobody else can be one of these principals."""

    name = _NAME

    def __init__(self, rules: Mapping[str, Rule]) -> None:
        super().__init__()
        self._rules = rules

    def reconfigure(self, rules: Mapping[str, Rule]) -> None:
        """Apply another configuration; the caller reviews the sessions."""
        self._rules = rules

    def recognises(self, token: str) -> bool:
        """Recognise none."""
        return False

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        """Accept none."""
        raise Unauthenticated("unknown token")

    def renewed(self, principal: Principal) -> Principal | None:
        """Return the principal of a trigger that is still configured."""
        name = principal.proof.partition(" ")[2]
        rule = self._rules.get(name)
        return None if rule is None else principal_of(name, rule)

    @property
    def serves(self) -> bool:
        """Nobody can log in by it."""
        return False
