"""Remedies in terms of `rcpctl`: those of the gateway name fields of the protocol."""

from __future__ import annotations

from rcp_client.errors import LOOK
from rcp_protocol.errors import BY_CODE, RcpError

__all__ = ["remedy_of"]

_REMEDIES = {
    "estop_active": "Make sure the robot is safe, then run `rcpctl estop --reset`, or ask someone "
    "whose role may reset.",
    "invalid_value": "Run `rcpctl discover PATH` for the schema and examples.",
    "lease_held": "Wait until the holder releases it, or run `rcpctl lease acquire SCOPE --take "
    "--reason TEXT` if your priority is higher.",
    "lease_lost": "Run `rcpctl lease acquire SCOPE` before you send commands.",
    "lease_required": "Run `rcpctl lease acquire SCOPE` first.",
    "out_of_range": "Run `rcpctl discover PATH` for the bounds.",
    "token_expired": "Pass a new token with --token or RCP_TOKEN.",
    "unauthenticated": "Pass a valid key or token with --token or RCP_TOKEN.",
    "unknown_path": "Run `rcpctl discover` to list the available paths.",
    "unsupported_operation": "Run `rcpctl discover PATH` for its operations.",
    "deadline_exceeded": "Check the state of the robot, then try again with a longer --deadline or "
    "--timeout.",
}


def remedy_of(error: RcpError) -> str:
    """Return the remedy; the gateway's own if it is more specific than that of the code."""
    approval = (error.details or {}).get("approval")
    if error.code == "approval_required" and approval:
        return (
            f"Once `rcpctl approvals` shows {approval} as approved, run the same command again with "
            f"--approval {approval}."
        )
    if error.remedy == LOOK:
        return (
            "It may have been executed: check the robot and `rcpctl commands` before you repeat it."
        )
    kind = BY_CODE.get(error.code)
    general = kind is not None and error.remedy == kind.default_remedy
    remedy = _REMEDIES.get(error.code, error.remedy) if general else error.remedy
    return remedy.replace("PATH", error.path or "PATH")
