"""`rcpctl plan`: run the operations in a file as one command, and show its progress."""

from __future__ import annotations

from typing import Any

from rcp_client.client import Client
from rcp_client.command import Feedback
from rcp_client.console import show
from rcp_client.console.execute import follow
from rcp_client.console.output import Output, clean, compact
from rcp_client.messages import Reply
from rcp_client.plans import plan_of
from rcp_protocol.errors import RcpError

__all__ = ["plan"]

_PATH = "/system/plans"


async def plan(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Run a plan, or only check it; show the outcome of each step."""
    body = plan_of(args["input"])
    args = {**args, "path": _PATH}
    if not args["dry_run"]:
        return await follow(
            client, out, args, body, feedback_line=_feedback_line, ended=_ended, failed=_faults
        )
    envelope = {"type": "execute", "path": _PATH, "body": body, "dry_run": True}
    try:
        _checked(out, await client.request(envelope))
    except RcpError as error:
        _faults(out, error)
        raise
    return 0


def _feedback_line(out: Output, feedback: Feedback) -> str:
    step: dict[str, Any] = feedback.body or {}
    share = "" if feedback.progress is None else f"{feedback.progress:4.0%} "
    what = f"{step.get('step', '')}  {step.get('do', '')} {step.get('path', '')}".rstrip()
    detail = step.get("message") or ("" if "feedback" not in step else compact(step["feedback"]))
    return (
        f"{out.paint(step.get('state', feedback.status))} {share}{what}  {out.dim(clean(detail))}"
    )


def _checked(out: Output, reply: Reply) -> None:
    if out.json:
        show.reply(out, reply)
        return
    out.line(f"{out.paint(reply.status)} {clean(reply.message or '')}")
    rows = [
        (s["step"], s["do"], s.get("path", ""), compact(s["value"]) if "value" in s else "")
        for s in reply.body["steps"]
    ]
    out.table(("STEP", "DO", "PATH", "VALUE"), rows)
    if wanted := reply.body.get("approval"):
        out.line(f"Approval required for: {', '.join(wanted)}.")


def _ended(out: Output, reply: Reply) -> None:
    """Show the outcome of each step."""
    if out.json:
        show.reply(out, reply)
        return
    out.line(f"{out.paint(reply.status)} {clean(reply.message or '')}")
    _steps(out, (reply.body or {}).get("steps", []))


def _steps(out: Output, steps: list[dict[str, Any]]) -> None:
    rows = [(s["step"], s["state"], s["do"], s.get("path", ""), _said(s)) for s in steps]
    if rows:
        out.table(("STEP", "STATE", "DO", "PATH", ""), rows)


def _said(step: dict[str, Any]) -> str:
    if "error" in step:
        return clean(step["error"]["message"])
    return compact(step["result"]) if "result" in step else clean(step.get("message", ""))


def _faults(out: Output, error: RcpError) -> None:
    if out.json:
        return
    details = error.details or {}
    for fault in details.get("faults", []):
        out.aside(f"  {fault['step']}: {fault['code']}: {clean(fault['message'])}")
        if "remedy" in fault:
            out.aside(f"    {out.dim(clean(fault['remedy']))}")
    _steps(out, (details.get("body") or {}).get("steps", []))
