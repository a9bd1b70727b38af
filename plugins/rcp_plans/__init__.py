"""Plans: several operations as one command, checked as a whole, run with the sender's rights."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import Rule
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_plans.action import Plans
from rcp_plans.config import PlansTable, check_plans
from rcp_plans.examples import EXAMPLES
from rcp_plans.lines import LINES, plain_steps
from rcp_plans.model import Plan, PlanResult, PlanState, StepState

__all__ = ["rcp_features"]

_RESOURCE = Resource(
    name="action/plans",
    description="Many operations as one command: checked whole first, then run step by step.",
    value=list[PlanState],
    input=Plan,
    output=PlanResult,
    feedback=StepState,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    policy="parallel",
    examples=EXAMPLES,
    history=1,
)

_USE = Rule(("discover", "read", "subscribe", "execute"), ("/system/plans",))


def _table(gateway: GatewayConfig) -> dict[str, object]:
    return {"plans": gateway.plans}


def _check(table: PlansTable, _gateway: GatewayConfig) -> None:
    check_plans(table.plans)


def _make(table: PlansTable, _host: FeatureHost) -> Feature:
    plans = Plans(table.plans)
    return Feature(
        resources=(SystemResource(resource=_RESOURCE, action=plans),),
        services={LINES: plain_steps},
        reconfigure=plans.reconfigure,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `plans`."""
    return [
        FeatureKind(
            "plans",
            PlansTable,
            _make,
            __doc__ or "",
            table=_table,
            check=_check,
            grants={"operator": (_USE,), "agent": (_USE,)},
        ),
    ]
