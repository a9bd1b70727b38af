"""Compilation of a plan's conditions, limited in number and in the sender's time."""

from __future__ import annotations

from rcp_conditions import Condition, ConditionsMissing, ConditionTooCostly, condition
from rcp_kernel.errors import ConfigError, InvalidValue, NotImplementedByRobot, OutOfRange
from rcp_plans.pace import Allowance

__all__ = ["ConditionReader"]

_TEXT = 8192  # characters of all different conditions of a plan, which take time to compile


class ConditionReader:
    """Compiles the conditions of one plan."""

    def __init__(self, allowance: Allowance, principal: str) -> None:
        self._allowance = allowance
        self._principal = principal
        self._texts: set[str] = set()
        self._length = 0

    def check(self) -> None:
        """Refuse a plan with conditions if its sender's time budget is used up.

        :raises RateLimited: the budget is used up.
        """
        self._allowance.check(self._principal)

    def read(self, text: str, name: str) -> Condition:
        """Compile a condition, which is the field `name` of a step.

        :raises OutOfRange: it is too costly, or all conditions together are too long.
        :raises InvalidValue: it is invalid.
        :raises NotImplementedByRobot: nothing here evaluates conditions.
        """
        if text not in self._texts:
            self._texts.add(text)
            self._length += len(text)
        if self._length > _TEXT:
            raise OutOfRange(
                f"the plan's conditions have more than {_TEXT} characters in total",
                remedy="Split it into several plans.",
                details={"limit": _TEXT},
            )
        details = {"pointer": f"/{name}"}
        try:
            with self._allowance.spending(self._principal):
                return condition(text)
        except ConditionTooCostly as error:
            raise OutOfRange(f"`{name}`: {error}", remedy=error.remedy, details=details) from None
        except ConditionsMissing as error:
            raise NotImplementedByRobot(
                "this gateway does not evaluate conditions", remedy=error.remedy, details=details
            ) from None
        except ConfigError as error:
            raise InvalidValue(f"`{name}`: {error}", details=details) from None
