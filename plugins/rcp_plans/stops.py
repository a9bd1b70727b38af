"""Plans that only bring robots to rest: no quota and no queue delays them."""

from __future__ import annotations

from collections.abc import Callable

from rcp_kernel.errors import RcpError
from rcp_kernel.values import value_type
from rcp_kernel.wire import Request
from rcp_plans.lines import from_lines
from rcp_plans.model import PATH, Execute, Plan, Step

__all__ = ["only_stops"]

_LONGEST = 4096  # bytes inspected: a stop is short, and a flood of other plans must be cheap
_PLAN = value_type(Plan)


def only_stops(request: Request, stops: Callable[[Request], bool]) -> bool:
    """Return whether a request is a plan in which `stops` holds for every step."""
    if request.type != "execute" or request.path != PATH or len(bytes(request.body)) > _LONGEST:
        return False
    try:
        plan: Plan = request.decode_body(_PLAN, "plan")
    except RcpError:
        return False
    steps, faults = (plan.steps or (), ()) if plan.lines is None else from_lines(plan.lines)
    return bool(steps) and not faults and all(_is_stop(step, stops) for step in steps)


def _is_stop(step: Step, stops: Callable[[Request], bool]) -> bool:
    if not isinstance(step, Execute) or step.when or step.fallback or step.retry:
        return False
    return stops(Request(type="execute", path=step.path))
